// Ways to get about: to a place that was pointed at, back to the start, and back to where the pawn last stood safely.

import type { Vec3 } from "slicewalk";
import { distance, type Look, type Ray } from "./geometry";
import { pick } from "./measure";
import type { Stage } from "./modes/mode";
import { findStart } from "./start";
import { texts } from "./languages";

const FLOOR_NORMAL = 0.5;
/** The pawn is lost this far below everything. */
const LOST_M = 4;
/** Distance between remembered safe places, and their number. */
const APART_M = 0.5;
const REMEMBERED = 20;
/** Time that a pawn must have stood before its place counts as safe (s). */
const FIRM_S = 0.3;

export interface Spot {
  readonly at: Vec3;
  readonly look: Look;
}

export class Places {
  /** Where the walk began. */
  start: Spot | null = null;
  #safe: Spot[] = [];
  #firm = 0;
  #returning = false;

  constructor(readonly stage: Stage) {}

  /** Begins again, in another archive. */
  clear(): void {
    this.start = null;
    this.#safe = [];
    this.#firm = 0;
    this.#returning = false;
  }

  /** Remembers where the pawn stands, and brings it back if it fell out of the world. */
  watch(seconds: number): void {
    const { session } = this.stage;
    if (session === null) return;
    const { pawn, archive } = session;
    const { ground, missing } = pawn.state;
    this.#firm = ground === "walking" && missing === 0 ? this.#firm + seconds : 0;
    const last = this.#safe.at(-1);
    if (this.#firm > FIRM_S && (last === undefined || distance(last.at, pawn.at) > APART_M)) {
      this.#safe = [...this.#safe, { at: pawn.at, look: { ...pawn.look } }].slice(-REMEMBERED);
    }
    const bottom = archive.info.bounds?.min[2] ?? -Infinity;
    if (ground === "falling" && pawn.at[2] < bottom - LOST_M && !this.#returning) {
      this.stage.shell.messages.say(texts.news.fell);
      void (this.#safe.length === 0 ? this.#beginAnew() : this.back());
    }
  }

  /** Finds a place to stand where the walk began without one, as addresses may name any. */
  async #beginAnew(): Promise<void> {
    const { session, settings } = this.stage;
    if (session === null) return;
    this.#returning = true;
    const { archive, content, pawn } = session;
    const at = await findStart(archive, settings, content, new AbortController().signal).catch(() => null);
    if (session !== this.stage.session) return;
    if (at !== null) this.start = { at, look: { ...pawn.look } };
    await this.home();
  }

  /** Returns to the last safe place; again, to the one before. */
  async back(): Promise<void> {
    const { session } = this.stage;
    if (session === null || this.#returning) return;
    const here = session.pawn.at;
    let spot = this.#safe.pop();
    while (spot !== undefined && distance(spot.at, here) < APART_M) spot = this.#safe.pop();
    await this.go(spot ?? this.start);
  }

  async home(): Promise<void> {
    await this.go(this.start);
  }

  async go(spot: Spot | null): Promise<void> {
    const { session, settings } = this.stage;
    if (session === null || spot === null) return;
    this.#returning = true;
    try {
      Object.assign(session.pawn.look, spot.look);
      await session.goto(spot.at, settings);
    } catch {
      // A failed archive is reported elsewhere.
    } finally {
      this.#returning = false;
      this.#firm = 0;
    }
  }

  /** Sends the pawn to what a ray hits, on foot or at once. */
  async send(ray: Ray, atOnce: boolean): Promise<boolean> {
    const place = await this.floorAt(ray);
    const { session, shell, settings } = this.stage;
    if (session === null || place === null) return false;
    if (atOnce) {
      await session.goto(place, settings).catch(() => {});
    } else {
      void session.pawn.walkTo(place);
      shell.messages.say(texts.news.walkingThere);
    }
    return true;
  }

  /** Place where a pawn sent along a ray would stand: on the surface that the ray hits, or below the wall that it hits. */
  async floorAt(ray: Ray): Promise<Vec3 | null> {
    const { session, sight, settings, shell } = this.stage;
    if (session === null) return null;
    const signal = new AbortController().signal;
    try {
      const shown = sight?.enter(ray) ?? ray;
      const spot = await pick(session.archive, shown, signal);
      if (spot !== null && spot.normal[2] > FLOOR_NORMAL) return spot.at;
      if (spot !== null) {
        const back = session.archive.info.pixelSize + settings.width / 2;
        const [x, y] = [spot.at[0] - shown.direction[0] * back, spot.at[1] - shown.direction[1] * back];
        const half = session.archive.info.pixelSize / 2;
        const probe = [x - half, y - half, spot.at[2] - 1, x + half, y + half, spot.at[2]];
        const z = (await session.archive.floor(new Float64Array(probe), { load: true, signal }))[0] ?? NaN;
        if (Number.isFinite(z)) return [x, y, z];
      }
    } catch {
      return null; // a failed archive is reported elsewhere
    }
    shell.messages.say(texts.news.nothingThere);
    return null;
  }
}
