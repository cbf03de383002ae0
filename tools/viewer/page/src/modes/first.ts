// The first view: all of the scan, turning slowly, until a person walks in. Meanwhile it looks for the best place to begin.

import type { Vec3 } from "slicewalk";
import { add, clamp, direction, type Look } from "../geometry";
import { findView, type Start } from "../start";
import type { Orbit } from "./orbit";
import type { Stage } from "./mode";

/** Range and speed of the turn. */
const SWAY_DEGREES = 12;
const SWAY_PER_S = 0.35;
/**
 * Share of the picture that the scan fills: the camera approaches below `LESS` and retreats above `MORE`, but no farther
 * than all of the scan needs.
 */
const ENOUGH = 0.31;
const LESS = 0.28;
const MORE = 0.36;
const NEARER = 0.7;
const NEAREST = 0.35;
/** The camera moves by at least this share. */
const STEP = 1e-3;
/** Frames without news after which the picture counts as complete. */
const QUIET = 3;
/** Longest wait for a place that shows enough (ms). */
const LONGEST_MS = 15_000;
/** Longest wait for a better place after the person wants to walk in (ms). */
const PATIENCE_MS = 4_000;
/** Without a place to stand, one flies this much nearer than the frame. */
const FLIGHT_SHARE = 0.6;
const FLIGHT_M = 60;
/** Standing places that show less of the scan than this are left for a flight. */
const POOR = 0.35;

export class First {
  #shown = false;
  /** Time for which it has turned (s); null: a person has taken over. */
  #swayed: number | null = null;
  /** Whether it stands still, for people who wish no motion. */
  #still = false;
  #best: Start | null = null;
  #looking: AbortController | null = null;
  #done: Promise<void> = Promise.resolve();
  #found: Promise<void> = Promise.resolve();
  #loaded = -1;
  #quiet = 0;
  /** Number of the last picture that does not show all of the scan from where the camera is. */
  #before = 0;

  constructor(
    readonly stage: Stage,
    readonly orbit: Orbit,
  ) {}

  get shown(): boolean {
    return this.#shown;
  }

  /** Begins; `stands`: the pawn has a place already. */
  begin(stands: boolean): void {
    const { session, shell } = this.stage;
    if (session === null) return;
    this.orbit.frame();
    this.#shown = true;
    this.#quiet = 0;
    this.#best = null;
    this.#swayed = 0;
    this.#still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    shell.first.show(session.source.name, session.content);
    const looking = new AbortController();
    this.#looking = looking;
    const { archive, pawn, content } = session;
    let found = (): void => {};
    this.#found = new Promise((resolve) => (found = resolve));
    const better = (start: Start): void => {
      this.#best = start;
      if (start.covered >= POOR) found();
    };
    this.#done = findView(archive, this.stage.settings, content, stands ? pawn.at : null, looking.signal, better).catch(
      () => {}, // stopped, or a failed archive, which is reported elsewhere
    );
  }

  /** Approaches what is thin or open, and turns on, unless a person has taken over. */
  advance(seconds: number): void {
    if (!this.#shown || this.#swayed === null) return;
    const { cameras, canvas, session } = this.stage;
    const { orbit, framed } = cameras;
    const { unbuilt = 1, pending = 1, loaded = 0 } = session?.archive.stats ?? {};
    const quiet = unbuilt === 0 && pending === 0 && loaded === this.#loaded && session?.world.waiting === 0;
    this.#quiet = quiet ? this.#quiet + 1 : 0;
    this.#loaded = loaded;
    const isDrawn = this.#quiet > QUIET && this.#isOutlined;
    if (!isDrawn) this.#before = canvas.pictures;
    // A view that stands still needs another picture to be measured by.
    else if (canvas.pictures === this.#before) canvas.refresh();
    else if (canvas.measured > this.#before && framed !== null) {
      const { covered } = canvas;
      const now = orbit.distance / framed.distance;
      const wanted = covered < LESS || covered > MORE ? now * Math.max(NEARER, Math.sqrt(covered / ENOUGH)) : now;
      const share = clamp(wanted, NEAREST, 1);
      if (Math.abs(share - now) > STEP) {
        this.#before = canvas.pictures;
        cameras.approach(share);
      }
    }
    if (this.#still) return;
    this.#swayed += seconds;
    cameras.sway(SWAY_DEGREES * Math.sin(SWAY_PER_S * this.#swayed));
  }

  /** Whether all of the scan is drawn, at least from an overview level. */
  get #isOutlined(): boolean {
    const { session } = this.stage;
    return session !== null && (session.archive.info.levels === 0 || session.world.counts.overview > 0);
  }

  /** A person turns the scan. */
  touch(): void {
    this.#swayed = null;
  }

  end(): void {
    this.#looking?.abort();
    this.#looking = null;
    this.#shown = false;
    this.stage.shell.first.hide();
  }

  /** The place to begin: where most is seen, or in the air. */
  async start(): Promise<{ at: Vec3; look: Look; flies: boolean }> {
    const late = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));
    await Promise.race([this.#done, late(PATIENCE_MS)]);
    await Promise.race([this.#done, this.#found, late(LONGEST_MS)]);
    const best = this.#best as Start | null;
    if (best !== null && best.covered >= POOR) return { at: best.at, look: best.look, flies: false };
    const { cameras, settings } = this.stage;
    const { target, distance, look } = cameras.framed ?? cameras.orbit;
    const eye = add(target, direction(look), -Math.min(FLIGHT_M, FLIGHT_SHARE * Math.min(distance, cameras.orbit.distance)));
    return { at: add(eye, [0, 0, -settings.eye]), look: { ...look }, flies: true };
  }
}
