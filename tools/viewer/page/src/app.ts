// The page: opens archives, passes inputs to the pawn and draws the result, frame by frame.

import { SlicewalkError, type Stats, type Vec3 } from "slicewalk";
import { formatAddress, type Mode, type Place } from "./address";
import { Canvas } from "./canvas";
import { clamp, wrap, type Look, type Ray } from "./geometry";
import { readGamepad } from "./input/gamepad";
import { joined } from "./input/intent";
import { Keyboard } from "./input/keyboard";
import { Pointer } from "./input/pointer";
import { Sticks } from "./input/sticks";
import { pick } from "./measure";
import { Overlays } from "./overlays";
import { ALIGNED } from "./scene/alignment";
import { Cameras } from "./scene/cameras";
import { Cover } from "./scene/cover";
import { hasHeadset } from "./scene/headset";
import { Shading } from "./scene/material";
import { Conversions, type Opener } from "./conversions";
import type { Driven, Kiosk } from "./kiosk";
import { fromAddress, Session, type Source } from "./session";
import { loadSettings, saveSettings, walkerSettings, type Settings } from "./settings";
import type { Table } from "./table";
import { Sight } from "./sight";
import { texts } from "./texts.en";
import { Shell } from "./ui/shell";
import { Minimap } from "./ui/minimap";

const TURN_PER_S = 110;
const TILT_PER_S = 70;
const DRAG_DEGREES = 0.16;
const MOUSE_DEGREES = 0.11;
/** Interval at which texts and numbers are updated (ms). */
const WRITE_MS = 250;
const SECOND_MS = 1000;
/** Longest time that a frame counts for (s); after a longer one the page was in the background. */
const LONGEST_FRAME_S = 0.25;
const FLOOR_NORMAL = 0.5;
/** Time that a message about damage stays (ms). */
const DAMAGE_MS = 15_000;

const NO_STATS = {
  pages: { resident: 0, bytes: 0 },
  requests: 0,
  bytesLoaded: 0,
  colours: { missing: 0, requests: 0, bytes: 0 },
} satisfies Partial<Stats>;

export class App {
  readonly #shell: Shell;
  readonly #canvas: Canvas;
  readonly #cameras = new Cameras();
  readonly #pointer: Pointer;
  readonly #keyboard: Keyboard;
  readonly #sticks: Sticks;
  #settings = loadSettings();
  #session: Session | null = null;
  #minimap: Minimap | null = null;
  #opening: AbortController | null = null;
  #last: Source | null = null;
  #mode: Mode = "walk";
  #sight: Sight | null = null;
  #ready = false;
  #error: string | null = null;
  #troubled = false;
  /** The first damage found in the open archive. */
  #damage: string | null = null;
  #frames = 0;
  #fps = 0;
  #longestTask = 0;
  #seenTriangles = 0;
  readonly #overlays: Overlays;
  readonly conversions: Conversions;
  /** Drives the page in a public place. */
  kiosk: Kiosk | null = null;
  /** Keeps the shaders that all archives share. */
  readonly #shading = new Shading(new Cover(1, 1));

  constructor(parent: HTMLElement) {
    this.#shell = new Shell(parent, this.#settings, {
      mode: (mode) => this.setMode(mode),
      fly: () => this.#fly(),
      panel: () => this.#colour(),
      link: () => void this.#link(),
      screenshot: () => void this.#screenshot(),
      headset: () => void this.#wear(),
      help: () => this.#shell.help(),
      save: () => void this.conversions.download(),
      open: () => this.#shell.welcome.show(),
      files: (files) => void this.conversions.take(files),
      address: (url) => void this.#openAddress(url),
      close: () => this.#shell.canvas.focus(),
      settings: (settings) => void this.#change(settings),
      colouring: (colouring) => {
        if (this.#sight) this.#sight.colouring = colouring;
        this.#colour();
      },
      slices: () => this.#colour(),
      cloud: (shown) => this.#overlays.showCloud(shown),
      splats: (shown) => void this.#overlays.showSplats(shown),
      matter: (shown) => this.#overlays.showMatter(shown),
      align: (alignment) => this.#overlays.align(alignment),
      splatsFile: (file) => {
        if (this.#session === null) void this.conversions.take([file]);
        else this.#overlays.take(file, ALIGNED);
      },
    });
    const graphics = (lost: boolean): void => {
      this.#shell.messages.wait(lost ? texts.news.graphicsLost : null);
      if (!lost) this.#shell.messages.say(texts.news.graphicsBack);
    };
    this.#canvas = new Canvas(this.#shell.canvas, this.#cameras, graphics, (worn) => (this.#shell.toolbars.worn = worn));
    void hasHeadset().then((has) => (this.#shell.toolbars.hasHeadset = has));
    this.#overlays = new Overlays(this.#canvas, this.#shell);
    void this.#canvas.prepare(this.#shading.all);
    this.#canvas.scene.add(this.#shell.measure.marks);
    this.#keyboard = new Keyboard((code) => this.#key(code));
    this.#sticks = new Sticks(parent);
    this.#pointer = new Pointer(this.#shell.canvas, {
      drag: (right, down, pan) => this.#drag(right, down, pan),
      click: (x, y) => void this.#click(x, y),
      doubleClick: (x, y) => void this.#walkTo(x, y),
      hover: (x, y) => this.#hover(x, y),
      zoom: (factor) => this.#zoom(factor),
      captures: () => this.#mode === "walk" && this.#shell.toolbars.panel !== "measure",
      captured: (captured) => {
        this.#shell.crosshair.hidden = !captured;
        if (captured) this.#shell.messages.say(texts.news.captured);
      },
    });
    this.conversions = new Conversions(parent, this.#opener(), () => this.#shell.welcome.show());
    this.#watchTasks();
    let last = performance.now();
    this.#canvas.loop((now) => {
      this.#frame(clamp((now - last) / 1000, 0, LONGEST_FRAME_S));
      last = now;
    });
    window.setInterval(() => this.#write(), WRITE_MS);
    let counted = 0;
    window.setInterval(() => {
      this.#fps = this.#frames - counted;
      counted = this.#frames;
      if (this.#session !== null && !document.hidden) this.#sight?.adapt(this.#fps);
    }, SECOND_MS);
  }

  /** Opens an archive, at a place if given, and closes the previous one. */
  async open(source: Source, place: Pick<Place, "at" | "look" | "mode"> | null): Promise<void> {
    this.#opening?.abort();
    const opening = new AbortController();
    this.#opening = opening;
    this.#last = source;
    this.#leave();
    this.#shell.messages.clear();
    this.#shell.messages.wait(texts.loading.opening(source.name));
    try {
      const session = await Session.open(source, place?.at ?? null, place?.look ?? null, this.#settings, opening.signal);
      if (opening.signal.aborted) {
        session.close();
        return;
      }
      this.#enter(session, place?.mode ?? "walk");
    } catch (error) {
      if (!opening.signal.aborted) this.#fail(error);
    }
  }

  async #openAddress(url: string): Promise<void> {
    try {
      await this.open(fromAddress(url), null);
    } catch (error) {
      this.#fail(error); // not a valid address
    }
  }

  setMode(mode: Mode): void {
    this.#mode = mode;
    this.#shell.toolbars.mode = mode;
    if (mode !== "walk") this.#pointer.release();
    const { orbit } = this.#cameras;
    const pawn = this.#session?.pawn;
    if (pawn && mode !== "walk") {
      orbit.target = pawn.at;
      orbit.look.heading = mode === "plan" ? 0 : pawn.look.heading;
    }
    this.#see();
  }

  // Interface for programs and tests --------------------------------------------------------------------------------------------

  get state(): Record<string, unknown> {
    const pawn = this.#session?.pawn;
    const stats = this.#session?.archive.stats ?? NO_STATS;
    return {
      ready: this.#ready,
      error: this.#error,
      mode: this.#mode,
      at: pawn ? [...pawn.at] : [0, 0, 0],
      look: pawn ? [pawn.look.heading, pawn.look.pitch] : [0, 0],
      ground: pawn?.state.ground ?? "walking",
      speed: pawn?.state.speed ?? 0,
      missing: pawn?.state.missing ?? 0,
      pages: { resident: stats.pages.resident, bytes: stats.pages.bytes },
      requests: stats.requests,
      bytesLoaded: stats.bytesLoaded,
      colours: { ...stats.colours },
      drawn: {
        ...(this.#session?.world.counts ?? { pages: 0, overview: 0, coloured: 0, distant: 0 }),
        splats: this.#overlays.count,
      },
      frames: this.#frames,
      longestTaskMs: this.#longestTask,
      converting: this.conversions.converting,
      kiosk: this.kiosk?.state ?? null,
    };
  }

  async goto({ at, look }: { at?: Vec3; look?: readonly [number, number] }): Promise<void> {
    const session = this.#session;
    if (session === null) throw new SlicewalkError("invalid", "no archive is open");
    if (look !== undefined) this.#look({ heading: look[0], pitch: look[1] });
    if (at === undefined) return;
    await session.goto(at, this.#settings);
    this.#cameras.orbit.target = at;
  }

  /** Offers files beside the page, and the welcome if nothing opens at once. */
  offer({ archives, cloud }: Table, splats: Place["splats"], welcome: boolean): void {
    this.#overlays.offer(cloud);
    if (splats !== null) this.#overlays.take(splats.url, splats.alignment);
    this.#shell.welcome.offer(archives);
    if (welcome) this.#shell.welcome.show();
  }

  get session(): Session | null {
    return this.#session;
  }

  // Archives ---------------------------------------------------------------------------------------------------------------------

  #enter(session: Session, mode: Mode): void {
    this.#session = session;
    this.#error = null;
    this.#damage = null;
    this.#troubled = false;
    const { archive, world, pawn } = session;
    world.moveOrigin(pawn.at);
    this.#canvas.scene.add(world.group);
    archive.on("trouble", (error) => this.#trouble(error));
    archive.on("failed", (error) => this.#fail(error));
    pawn.onArrival = (how) => this.#shell.messages.say(how === "arrived" ? texts.news.arrived : texts.news.gaveUp);
    this.#minimap = new Minimap(archive);
    this.#shell.colours.offer(archive.info.voxels.coloured > 0);
    this.#sight = new Sight(session, this.#shell);
    this.#sight.colouring = this.#shell.colours.chosen;
    this.#shell.opened(session.source.name, archive.info, this.#minimap);
    this.setMode(mode);
    this.#shell.toolbars.flying = pawn.flying;
    this.#overlays.opened(session);
    // The first picture and the first texts take long, so the walk begins after them.
    this.#frame(0);
    this.#write();
    this.#ready = true;
    this.#shell.messages.wait(null);
    this.#shell.messages.say(pawn.flying ? texts.loading.found : texts.news.capture);
    this.#shell.canvas.focus({ preventScroll: true });
    void session.describe();
  }

  #leave(): void {
    this.#ready = false;
    this.#minimap = null;
    this.#overlays.left();
    const session = this.#session;
    this.#session = null;
    if (session === null) return;
    this.#canvas.scene.remove(session.world.group);
    this.#shell.measure.clear();
    session.close();
  }

  #trouble(error: SlicewalkError | null): void {
    if (error !== null && error.kind !== "network") {
      // Reported once: damaged colours leave shapes grey, damaged pages block the pawn.
      if (this.#damage === null) this.#shell.messages.say(texts.news.damage(error.message), DAMAGE_MS);
      this.#damage ??= error.message;
    } else if (error !== null) {
      this.#troubled = true;
      this.#shell.messages.wait(texts.news.trouble(error.message));
    } else if (this.#troubled) {
      this.#troubled = false;
      this.#shell.messages.wait(null);
      this.#shell.messages.say(texts.news.back);
    }
  }

  /** Reports an error with possible actions; the picture stays. */
  #fail(error: unknown): void {
    const known = error instanceof SlicewalkError ? error : null;
    const message = error instanceof Error ? error.message : String(error);
    const kind = known?.kind ?? "page";
    this.#error = `${texts.errors[kind].title}: ${message}`;
    this.#ready = false;
    this.#pointer.release();
    this.#shell.messages.wait(null);
    const source = this.#last;
    const pawn = this.#session?.pawn;
    const place = pawn ? { at: pawn.at, look: { ...pawn.look }, mode: this.#mode } : null;
    const again = source === null ? [] : [{ label: texts.actions.again, act: () => void this.open(source, place) }];
    const other = { label: texts.actions.other, act: () => this.#shell.welcome.show() };
    this.#shell.messages.trouble(kind, message, [...again, other]);
  }

  // Inputs -----------------------------------------------------------------------------------------------------------------------

  #key(code: string): void {
    const toggle = (mode: Mode): void => this.setMode(this.#mode === mode ? "walk" : mode);
    const keys: Record<string, () => void> = {
      KeyM: () => toggle("plan"),
      KeyO: () => toggle("orbit"),
      KeyF: () => this.#fly(),
      KeyH: () => this.#shell.help(),
      Escape: () => this.#shell.toolbars.show(null),
    };
    if (this.#session !== null || code === "KeyH") keys[code]?.();
  }

  #fly(): void {
    const pawn = this.#session?.pawn;
    if (pawn === undefined) return;
    pawn.stop();
    pawn.flying = !pawn.flying;
    this.#shell.toolbars.flying = pawn.flying;
    this.#shell.messages.say(pawn.flying ? texts.news.flyOn : texts.news.flyOff);
  }

  #look({ heading, pitch }: Look): void {
    const look = this.#session?.pawn.look;
    if (look) Object.assign(look, { heading: wrap(heading), pitch: clamp(pitch, -89, 89) });
  }

  #drag(right: number, down: number, pan: boolean): void {
    const pawn = this.#session?.pawn;
    if (pawn === undefined) return;
    const high = Math.max(this.#shell.canvas.clientHeight, 1);
    if (this.#mode !== "walk") {
      if (pan || this.#mode === "plan") this.#cameras.pan(right / high, -down / high);
      else this.#cameras.turn(right * 2 * DRAG_DEGREES, -down * 2 * DRAG_DEGREES);
      return;
    }
    // A captured mouse turns the head; dragging moves the picture.
    const degrees = this.#settings.sensitivity * (this.#pointer.captured ? MOUSE_DEGREES : -DRAG_DEGREES);
    this.#look({ heading: pawn.look.heading + right * degrees, pitch: pawn.look.pitch - down * degrees });
  }

  #zoom(factor: number): void {
    if (this.#mode === "walk") return;
    this.#cameras.zoom(factor);
    this.#see();
  }

  #ray(x: number, y: number): Ray | null {
    return this.#session && this.#cameras.ray(x, y, this.#session.world);
  }

  #hover(x: number, y: number): void {
    const ray = this.#ray(x, y);
    if (this.#session && ray && this.#shell.toolbars.panel === "measure") this.#shell.measure.hover(this.#session.archive, ray);
  }

  async #click(x: number, y: number): Promise<void> {
    const session = this.#session;
    const ray = this.#ray(x, y);
    if (session === null || ray === null) return;
    if (this.#shell.toolbars.panel === "measure") {
      await this.#shell.measure.click(session.archive, session.world, ray);
      return;
    }
    const place = await this.#floorAt(ray);
    if (place !== null) await session.goto(place, this.#settings).catch(() => {});
  }

  async #walkTo(x: number, y: number): Promise<void> {
    const ray = this.#ray(x, y);
    const place = ray && (await this.#floorAt(ray));
    if (!place || this.#session === null) return;
    this.#session.pawn.walkTo(place);
    this.#shell.messages.say(texts.news.walkingThere);
  }

  /**
   * Place where a pawn sent along a ray would stand: on the surface that the ray hits, or below the wall that it hits.
   */
  async #floorAt(ray: Ray): Promise<Vec3 | null> {
    const session = this.#session;
    if (session === null) return null;
    const signal = new AbortController().signal;
    try {
      const shown = this.#sight?.enter(ray) ?? ray;
      const spot = await pick(session.archive, shown, signal);
      if (spot !== null && spot.normal[2] > FLOOR_NORMAL) return spot.at;
      if (spot !== null) {
        const back = session.archive.info.pixelSize + this.#settings.width / 2;
        const [x, y] = [spot.at[0] - shown.direction[0] * back, spot.at[1] - shown.direction[1] * back];
        const half = session.archive.info.pixelSize / 2;
        const probe = [x - half, y - half, spot.at[2] - 1, x + half, y + half, spot.at[2]];
        const z = (await session.archive.floor(new Float64Array(probe), { load: true, signal }))[0] ?? NaN;
        if (Number.isFinite(z)) return [x, y, z];
      }
    } catch {
      return null; // a failed archive is reported elsewhere
    }
    this.#shell.messages.say(texts.news.nothingThere);
    return null;
  }

  async #change(settings: Settings): Promise<void> {
    const before = this.#settings;
    this.#settings = settings;
    try {
      await this.#session?.pawn.walker.set(walkerSettings(settings));
    } catch (error) {
      if (!(error instanceof SlicewalkError) || error.kind !== "invalid") return;
      this.#settings = { ...settings, width: before.width, height: before.height, climb: before.climb, eye: before.eye };
      this.#shell.messages.say(texts.settings.refused);
    }
    saveSettings(this.#settings);
    this.#shell.settings.show(this.#settings);
    this.#see();
  }

  async #link(): Promise<void> {
    const session = this.#session;
    if (session === null) return;
    if (session.source.link === null) {
      this.#shell.messages.say(texts.news.local);
      return;
    }
    const { pawn, source } = session;
    const address = formatAddress({
      archive: source.link,
      at: pawn.at,
      look: pawn.look,
      mode: this.#mode,
      splats: this.#overlays.link,
    });
    history.replaceState(null, "", address);
    try {
      await navigator.clipboard.writeText(location.href);
      this.#shell.messages.say(texts.news.linkCopied);
    } catch {
      this.#shell.messages.say(texts.news.link);
    }
  }

  async #screenshot(): Promise<void> {
    const picture = await this.#canvas.picture();
    if (picture === null) return;
    const name = `slicewalk-${new Date().toISOString().slice(0, 19).replaceAll(":", "-")}.png`;
    const anchor = document.createElement("a");
    anchor.href = URL.createObjectURL(picture);
    anchor.download = name;
    anchor.click();
    URL.revokeObjectURL(anchor.href);
    this.#shell.messages.say(texts.news.screenshot(name));
  }

  /** Starts or ends the use of the headset. */
  async #wear(): Promise<void> {
    const { headset } = this.#canvas;
    const pawn = this.#session?.pawn;
    if (pawn === undefined) return;
    try {
      if (headset.worn) await headset.leave();
      else {
        this.setMode("walk");
        await headset.enter(pawn.look.heading);
      }
    } catch (error) {
      this.#shell.messages.say(texts.news.noHeadset(error instanceof Error ? error.message : String(error)));
    }
  }

  // Frames -----------------------------------------------------------------------------------------------------------------------

  #frame(seconds: number): void {
    this.#frames++;
    const session = this.#session;
    if (session === null) {
      this.#canvas.render();
      return;
    }
    const { pawn, world, view } = session;
    const { headset } = this.#canvas;
    const intent = joined([
      this.#keyboard.read(),
      readGamepad(),
      this.#sticks.read(),
      headset.read(),
      ...(this.kiosk ? [this.kiosk.intent] : []),
    ]);
    if (intent.turn !== 0 || intent.tilt !== 0) {
      const [turn, tilt] = [intent.turn * TURN_PER_S * seconds, intent.tilt * TILT_PER_S * seconds];
      if (this.#mode === "walk") this.#look({ heading: pawn.look.heading + turn, pitch: pawn.look.pitch + tilt });
      else this.#cameras.turn(turn, tilt);
    }
    const heading = this.#cameras.heading(pawn.look);
    if (this.#ready) pawn.step(seconds, intent, heading);
    // Seen from outside, a pawn faces where it walks.
    if (this.#mode !== "walk" && (intent.forward !== 0 || intent.right !== 0)) {
      pawn.look.heading = wrap(heading + (Math.atan2(intent.right, intent.forward) * 180) / Math.PI);
      this.#cameras.orbit.target = pawn.at;
    }
    const eye = pawn.eye(this.#settings.eye, seconds);
    this.#cameras.update(this.#mode, world, eye, pawn.look);
    if (world.moveOrigin(this.#mode === "walk" ? eye : this.#cameras.orbit.target)) {
      this.#cameras.update(this.#mode, world, eye, pawn.look);
      this.#shell.measure.moved(world);
      this.#overlays.place();
    }
    // Visible pages load after those that the first step needs.
    if (headset.worn) Object.assign(pawn.look, headset.place(world, eye, this.#settings.eye));
    const from = this.#mode === "walk" ? eye : this.#cameras.stand;
    if (pawn.state.ticks > 0) view.look(from);
    world.settle();
    void this.#sight?.follow(pawn.at, this.#settings);
    this.#sight?.update();
    this.#seenTriangles = world.cull(this.#canvas.camera, from);
    const { distance } = this.#cameras.orbit;
    this.#canvas.mark(this.#mode !== "walk", world, pawn.state, pawn.look, this.#settings.width, distance);
    this.#canvas.render();
    this.#minimap?.update(pawn.at, pawn.look.heading);
  }

  /** The page for conversions. */
  #opener(): Opener {
    const page = this;
    return {
      open: (source) => page.open(source, null),
      say: (text) => page.#shell.messages.say(text),
      get source() {
        return page.session?.source ?? null;
      },
      get error() {
        return page.#error;
      },
    };
  }

  /** The page for a kiosk. */
  get drive(): Driven {
    const page = this;
    return {
      get at() {
        return page.session?.pawn.at ?? null;
      },
      get look() {
        return page.session?.pawn.look ?? null;
      },
      get mode() {
        return page.#mode;
      },
      setMode: (mode) => page.setMode(mode),
      goto: (place) => page.goto(place),
      walkTo: (place, arrived) => {
        const pawn = page.session?.pawn;
        if (pawn === undefined) return;
        pawn.flying = false;
        pawn.onArrival = arrived;
        pawn.walkTo(place);
      },
      stop: () => page.session?.pawn.stop(),
    };
  }

  #see(): void {
    if (this.#session !== null) this.#sight?.see(this.#mode, this.#settings, this.#cameras.orbit.distance);
  }

  #colour(): void {
    if (this.#session !== null) this.#sight?.colour(this.#settings);
  }

  #write(): void {
    const session = this.#session;
    if (session === null) return;
    const { archive, pawn, crs } = session;
    const facts = { state: pawn.state, stats: archive.stats, crs, fps: this.#fps, triangles: this.#seenTriangles };
    this.#shell.status.update(facts);
    this.#shell.slices.update(pawn.at[2]);
    if (!this.#troubled && this.#ready && !this.#canvas.lost) {
      const waits = pawn.state.missing;
      const reason = this.#damage === null ? texts.loading.waiting(waits) : texts.loading.damaged(waits, this.#damage);
      this.#shell.messages.wait(waits > 0 ? reason : null);
    }
  }

  #watchTasks(): void {
    try {
      const observer = new PerformanceObserver((list) => {
        for (const { duration } of list.getEntries()) this.#longestTask = Math.max(this.#longestTask, duration);
      });
      observer.observe({ type: "longtask", buffered: false });
    } catch {
      // Some browsers do not measure tasks; the number stays 0.
    }
  }
}
