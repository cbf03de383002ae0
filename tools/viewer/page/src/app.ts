// The page: opens archives, passes inputs to the pawn and draws the result, frame by frame. How each way to look answers
// is in `modes`, ways to get about are in `places.ts`.

import { SlicewalkError, type Stats, type Vec3 } from "slicewalk";
import { formatAddress, type Mode, type Place } from "./address";
import { Canvas } from "./canvas";
import { clamp, distance, isNumbers, metres, wrap, type Look, type Ray } from "./geometry";
import { readGamepad } from "./input/gamepad";
import { joined, moves, steers } from "./input/intent";
import { Keyboard } from "./input/keyboard";
import { Pointer } from "./input/pointer";
import { findObstacle, type Obstacle, PATIENCE_MS } from "./obstacle";
import { Sticks } from "./input/sticks";
import { First } from "./modes/first";
import { Fly } from "./modes/fly";
import type { Mode as ModeOf, Stage } from "./modes/mode";
import { Orbit } from "./modes/orbit";
import { Plan } from "./modes/plan";
import { Walk } from "./modes/walk";
import { Overlays } from "./overlays";
import type { Pawn } from "./pawn";
import { Places } from "./places";
import { ALIGNED } from "./scene/alignment";
import { Cameras } from "./scene/cameras";
import { Cover } from "./scene/cover";
import { Goal } from "./scene/goal";
import type { World } from "./scene/world";
import { hasHeadset } from "./scene/headset";
import { Shading } from "./scene/material";
import { Conversions, fetchScan, type Opener } from "./conversions";
import type { Driven, Kiosk } from "./kiosk";
import { fromAddress, Session, type Source } from "./session";
import { loadSettings, QUALITIES, saveSettings, THEMES, walkerSettings, type Settings } from "./settings";
import { CUT_ABOVE_M } from "./plan/drawing";
import { Sheet } from "./plan/sheet";
import { copyLink, savePicture, savePlan, toggleFullscreen } from "./share";
import { Sight } from "./sight";
import type { Table } from "./table";
import { texts } from "./languages";
import type { Action } from "./ui/messages";
import { Minimap } from "./ui/minimap";
import { Shell } from "./ui/shell";
import { Stops } from "./ui/stops";

const TURN_PER_S = 110;
const TILT_PER_S = 70;
/** Interval at which texts and numbers are updated (ms). */
const WRITE_MS = 250;
const SECOND_MS = 1000;
/** Longest time that a frame counts for (s); after a longer one the page was in the background. */
const LONGEST_FRAME_S = 0.25;
/** Time that a message about damage stays (ms). */
const DAMAGE_MS = 15_000;

const NO_STATS = {
  pages: { resident: 0, bytes: 0 },
  requests: 0,
  bytesLoaded: 0,
  colours: { missing: 0, requests: 0, bytes: 0 },
} satisfies Partial<Stats>;

/** Places lie within this distance of zero along each axis (m), as the walker requires. */
const FARTHEST_M = 1e9;

/** Where a walk begins, as far as it is named; null: in the first view. */
type Begin = Partial<Pick<Place, "at" | "look" | "mode">> | null;

const overtaken = (): SlicewalkError => new SlicewalkError("aborted", "another archive was opened meanwhile");

const blockedBy = (obstacle: Obstacle | null): string =>
  obstacle === null ? texts.news.gaveUp : texts.obstacles[obstacle.reason](metres(obstacle.needs));

export class App implements Stage {
  readonly shell: Shell;
  readonly canvas: Canvas;
  readonly cameras = new Cameras();
  readonly pointer: Pointer;
  settings = loadSettings();
  session: Session | null = null;
  sight: Sight | null = null;
  readonly #keyboard: Keyboard;
  readonly #sticks: Sticks;
  readonly #orbit = new Orbit(this);
  readonly #modes: Record<Mode, ModeOf> = { walk: new Walk(this), orbit: this.#orbit, plan: new Plan(this) };
  readonly #fly = new Fly(this);
  readonly #first = new First(this, this.#orbit);
  readonly #places = new Places(this);
  readonly #goal = new Goal();
  readonly #stops: Stops;
  readonly #overlays: Overlays;
  /** Keeps the shaders that all archives share. */
  readonly #shading = new Shading(new Cover(1, 1));
  readonly #light = matchMedia("(prefers-color-scheme: light)");
  #minimap: Minimap | null = null;
  #sheet: Sheet | null = null;
  #opening: AbortController | null = null;
  /** Reads what an address holds, until something else is chosen. */
  #fetching: AbortController | null = null;
  /** What was opened last, and where. */
  #last: { readonly source: Source; readonly place: Begin } | null = null;
  #mode: Mode = "walk";
  #ready = false;
  /** Whether a person waits for a place to walk in. */
  #entering = false;
  #error: string | null = null;
  #troubled = false;
  /** The first damage found in the open archive. */
  #damage: string | null = null;
  #frames = 0;
  #fps = 0;
  #longestTask = 0;
  #seenTriangles = 0;
  readonly conversions: Conversions;
  /** Drives the page in a public place. */
  kiosk: Kiosk | null = null;

  constructor(parent: HTMLElement) {
    this.shell = new Shell(parent, this.settings, {
      mode: (mode) => this.setMode(mode),
      fly: () => this.#flight(),
      panel: () => this.#colour(),
      link: () => void copyLink(this, this.#place()),
      screenshot: () => void savePicture(this),
      plan: () => void savePlan(this),
      fullscreen: () => void toggleFullscreen(),
      headset: () => void this.#wear(),
      help: () => this.shell.help(),
      open: () => this.#choose(),
      home: () => this.#home(),
      walkIn: () => void this.#walkIn(null),
      save: () => void this.conversions.download(),
      files: (files) => this.#take(files),
      address: (url) => void this.#openAddress(url),
      close: () => this.shell.canvas.focus(),
      settings: (settings) => void this.#change(settings),
      colouring: (colouring) => {
        if (this.sight) this.sight.colouring = colouring;
        this.#colour();
      },
      blocks: (blocks) => this.sight?.showBlocks(blocks),
      slices: () => this.#colour(),
      cloud: (shown) => this.#overlays.showCloud(shown),
      splats: (shown) => void this.#overlays.showSplats(shown),
      matter: (shown) => this.#overlays.showMatter(shown),
      align: (alignment) => this.#overlays.align(alignment),
      splatsFile: (file) => {
        if (this.session === null || this.#isKiosk) this.#take([file]);
        else this.#overlays.take(file, ALIGNED);
      },
    });
    const graphics = (lost: boolean): void => {
      this.shell.messages.wait(lost ? texts.news.graphicsLost : null);
      if (!lost) this.shell.messages.say(texts.news.graphicsBack);
    };
    this.canvas = new Canvas(this.shell.canvas, this.cameras, graphics, (worn) => (this.shell.toolbars.worn = worn));
    void hasHeadset().then((has) => (this.shell.toolbars.hasHeadset = has));
    this.#overlays = new Overlays(this.canvas, this.shell);
    this.#stops = new Stops(this.shell.stop, {
      crouch: () => this.#keyboard.latchCrouch(),
      smaller: () => void this.#change({ ...this.settings, width: 0.3, height: 1.2, eye: 1.1 }),
      fly: () => this.#flight(),
    });
    this.#theme();
    this.#light.addEventListener("change", () => this.#theme());
    void this.canvas.prepare(this.#shading.of(this.#shading.effort), true);
    this.canvas.marks.add(this.shell.measure.marks, this.#goal.group);
    this.#keyboard = new Keyboard((code) => this.#key(code));
    this.#sticks = new Sticks(parent);
    this.pointer = new Pointer(this.shell.canvas, {
      drag: (right, down, pan) => {
        this.#first.touch();
        this.#view.drag(right, down, pan);
      },
      click: (x, y) => void this.#click(x, y, false),
      doubleClick: (x, y) => void this.#click(x, y, true),
      hover: (x, y) => this.#hover(x, y),
      zoom: (factor) => {
        this.#first.touch();
        this.#view.zoom(factor);
        if (this.#view.outside) this.#see();
      },
      captures: () => this.#mode === "walk" && this.shell.toolbars.panel !== "measure",
      captured: (captured) => {
        this.shell.crosshair.hidden = !captured;
        if (captured) this.shell.messages.say(texts.news.captured);
      },
      refused: () => this.shell.messages.say(texts.news.refused),
    });
    this.conversions = new Conversions(parent, this.shell.foot, this.#opener(), () => this.#choose());
    this.shell.messages.dismissed = () => {
      // A kiosk offers no other way on; without a scan there is nothing to act on but the choice.
      if (this.#isKiosk && this.#error !== null) this.shell.messages.dialog.showModal();
      else if (this.session === null) this.#choose();
    };
    this.#watchTasks();
    let last = performance.now();
    this.canvas.loop((now) => {
      this.#frame(clamp((now - last) / 1000, 0, LONGEST_FRAME_S));
      last = now;
    });
    window.setInterval(() => this.#write(), WRITE_MS);
    let counted = 0;
    window.setInterval(() => {
      this.#fps = this.#frames - counted;
      counted = this.#frames;
      const rate = this.canvas.rate();
      if (this.session !== null && !document.hidden) this.sight?.adapt(rate);
    }, SECOND_MS);
  }

  /**
   * Opens an archive, at a place if given, and then closes the previous one: an archive that cannot be opened leaves the
   * walk as it is. Resolves to null, or to the reason why it is not open, which the page shows unless another archive was
   * opened meanwhile.
   */
  async open(source: Source, place: Begin): Promise<SlicewalkError | null> {
    this.#opening?.abort();
    this.#fetching?.abort();
    const opening = new AbortController();
    this.#opening = opening;
    if (this.session === null) this.#last = { source, place };
    this.shell.messages.clear();
    this.shell.messages.wait(texts.loading.opening(source.name));
    try {
      const session = await Session.open(source, place?.at ?? null, place?.look ?? null, this.settings, opening.signal);
      if (opening.signal.aborted) {
        session.close();
        return overtaken();
      }
      this.#last = { source, place };
      this.#leave();
      this.#enter(session, place ?? {});
      this.conversions.entered(source);
      return null;
    } catch (error) {
      if (opening.signal.aborted) return overtaken();
      this.#report(error);
      return error instanceof SlicewalkError ? error : new SlicewalkError("engine", String(error), { cause: error });
    }
  }

  /** Opens or converts files that a person chose; a kiosk shows one archive. */
  #take(files: readonly File[]): void {
    if (this.#isKiosk) return;
    this.#fetching?.abort();
    this.shell.messages.wait(null);
    void this.conversions.take(files);
  }

  /** The scan at an address, null for an archive; fails with `aborted` if something else is chosen meanwhile. */
  #fetch(source: Source): Promise<File | null> {
    this.#fetching?.abort();
    this.#fetching = new AbortController();
    return fetchScan(source, this.#fetching.signal);
  }

  async #openAddress(url: string): Promise<void> {
    let source: Source;
    try {
      source = fromAddress(url);
      this.shell.messages.wait(texts.loading.opening(source.name));
      const scan = await this.#fetch(source);
      this.shell.messages.wait(null);
      if (scan !== null) {
        await this.conversions.take([scan]);
        return;
      }
    } catch (error) {
      if (!(error instanceof SlicewalkError && error.kind === "aborted")) this.#report(error);
      return;
    }
    await this.open(source, null);
    // What was chosen is in the address: it can be reloaded, and Back returns to the one before.
    if (this.session?.source === source) {
      history.pushState(null, "", formatAddress({ archive: url, at: null, look: null, mode: null, splats: null }));
    }
  }

  setMode(mode: Mode): void {
    this.#first.end();
    this.#mode = mode;
    this.shell.toolbars.mode = mode;
    if (mode !== "walk") this.pointer.release();
    this.#view.begin();
    this.#see();
  }

  // Interface for programs and tests --------------------------------------------------------------------------------------------

  get state(): Record<string, unknown> {
    const pawn = this.session?.pawn;
    const stats = this.session?.archive.stats ?? NO_STATS;
    return {
      ready: this.#ready,
      error: this.#error,
      mode: this.#mode,
      at: pawn ? [...pawn.at] : [0, 0, 0],
      look: pawn ? [pawn.look.heading, pawn.look.pitch] : [0, 0],
      ground: pawn?.state.ground ?? "walking",
      speed: pawn?.state.speed ?? 0,
      missing: pawn?.state.missing ?? 0,
      covered: this.session === null ? 0 : this.canvas.covered,
      pages: { resident: stats.pages.resident, bytes: stats.pages.bytes },
      requests: stats.requests,
      bytesLoaded: stats.bytesLoaded,
      colours: { ...stats.colours },
      drawn: {
        ...(this.session?.world.counts ?? { pages: 0, overview: 0, coloured: 0, distant: 0 }),
        ...this.#overlays.counts,
      },
      frames: this.#frames,
      pictures: this.canvas.pictures,
      longestTaskMs: this.#longestTask,
      converting: this.conversions.converting,
      kiosk: this.kiosk?.state ?? null,
    };
  }

  async goto({ at, look }: { at?: Vec3; look?: readonly [number, number] } = {}): Promise<void> {
    const { session } = this;
    if (session === null) throw new SlicewalkError("invalid", "no archive is open");
    if (look !== undefined && !isNumbers(look, 2)) {
      throw new SlicewalkError("invalid", `a look is two finite numbers, heading and pitch, found ${String(look)}`);
    }
    if (at !== undefined && !isNumbers(at, 3, FARTHEST_M)) {
      throw new SlicewalkError("invalid", `a place is three numbers within ±1e9 m, found ${String(at)}`);
    }
    if (this.#first.shown) this.setMode("walk");
    if (look !== undefined) this.#look({ heading: look[0], pitch: look[1] });
    if (at === undefined) return;
    const to: Vec3 = [...at];
    await session.goto(to, this.settings);
    this.cameras.orbit.target = to;
  }

  /** Offers files beside the page, and the welcome if nothing opens at once. */
  offer({ archives, cloud }: Table, splats: Place["splats"], welcome: boolean): void {
    this.#overlays.offer(cloud);
    if (splats !== null) this.#overlays.take(splats.url, splats.alignment);
    this.shell.welcome.offer(archives);
    if (!welcome) return;
    if (this.#isKiosk) this.#fail(new SlicewalkError("invalid", "neither the address nor archives.json names an archive"));
    else this.#choose();
  }

  get #isKiosk(): boolean {
    return this.kiosk?.isKiosk === true;
  }

  /** Offers a choice of what to open; a kiosk shows one archive. */
  #choose(): void {
    if (!this.#isKiosk) this.shell.welcome.show();
  }

  /** Opens what an address names, unless it is open already. */
  async visit(url: string, place: Place): Promise<void> {
    try {
      const source = fromAddress(url);
      if (this.session !== null && this.session.source.archive === source.archive) {
        if (place.mode !== null && place.mode !== this.#mode) this.setMode(place.mode);
        await this.goto({
          ...(place.at && { at: place.at }),
          ...(place.look && { look: [place.look.heading, place.look.pitch] }),
        });
      } else await this.open(source, place);
    } catch (error) {
      this.#report(error);
    }
  }

  // Archives ---------------------------------------------------------------------------------------------------------------------

  #enter(session: Session, { at, look, mode }: NonNullable<Begin>): void {
    this.session = session;
    this.#error = null;
    this.#damage = null;
    this.#troubled = false;
    const { archive, world, pawn } = session;
    const isFirst = !at && !look && !mode;
    this.canvas.scene.add(world.group);
    this.canvas.sky.light(world.shading, mode === "plan");
    archive.on("trouble", (error) => this.#trouble(error));
    archive.on("failed", (error) => this.#fail(error));
    pawn.onNoRoute = (to, signal) => this.#explain(to, signal);
    this.#tellArrivals(pawn);
    this.#sheet = new Sheet(archive);
    this.canvas.marks.add(this.#sheet.group);
    this.#minimap = new Minimap(
      archive,
      (place) => void this.#goThere(place),
      (at) => void this.#places.go({ at, look: pawn.look }),
    );
    this.shell.colours.offer(archive.info.voxels.coloured > 0);
    this.sight = new Sight(session, this.shell, this.cameras, this.canvas);
    this.sight.colouring = this.shell.colours.chosen;
    this.sight.showBlocks(this.shell.colours.blocks);
    this.shell.opened(session.source.name, archive.info, session.content, this.#minimap);
    this.#places.clear();
    this.#places.start = { at: pawn.at, look: { ...pawn.look } };
    this.setMode(isFirst ? "orbit" : (mode ?? "walk"));
    if (isFirst || (mode === "orbit" && !at)) this.#first.begin(!pawn.flying);
    if (!isFirst && this.#first.shown) this.shell.first.hide();
    world.moveOrigin(this.#view.outside ? this.cameras.orbit.target : pawn.at);
    this.#see();
    this.shell.toolbars.flying = pawn.flying;
    this.#overlays.opened(session);
    // The first picture and the first texts take long, so the walk begins after them.
    this.#frame(0);
    this.#write();
    this.#ready = true;
    this.shell.messages.wait(null);
    if (!this.#first.shown) this.#welcome(pawn.flying);
    this.shell.canvas.focus({ preventScroll: true });
    void session.describe();
    void this.kiosk?.opened(session.source.link);
  }

  #tellArrivals(pawn: Pawn): void {
    pawn.onArrival = (how) => this.shell.messages.say(how === "arrived" ? texts.news.arrived : blockedBy(pawn.obstacle));
  }

  /** Ends the first view: at its best place, or at one that was pointed at. */
  async #walkIn(place: Vec3 | null): Promise<void> {
    const { session } = this;
    if (session === null || !this.#first.shown) return;
    this.shell.messages.wait(texts.loading.place);
    this.#entering = true;
    const { at, look, flies } = await this.#first.start();
    this.#entering = false;
    if (session !== this.session || !this.#first.shown) return;
    if (place === null) {
      session.pawn.flying = flies;
      this.shell.toolbars.flying = flies;
      Object.assign(session.pawn.look, look);
    } else {
      session.pawn.flying = this.shell.toolbars.flying = false;
      session.pawn.look.heading = this.cameras.orbit.look.heading;
    }
    const to = place ?? at;
    // The pawn is there before the view is: otherwise the first pictures are of where it stood.
    await session.pawn.place(to).catch(() => {});
    if (session !== this.session || !this.#first.shown) return;
    this.setMode("walk");
    this.#places.start = { at: to, look: { ...session.pawn.look } };
    await session.goto(to, this.settings).catch(() => {});
    this.shell.messages.wait(null);
    this.#welcome(session.pawn.flying);
    this.shell.canvas.focus({ preventScroll: true });
  }

  /** Says why there is no way to a place. */
  async #explain(to: Vec3, signal: AbortSignal): Promise<Obstacle | null> {
    const { session, settings } = this;
    if (session === null) return null;
    const { noRoute } = texts.news;
    this.shell.messages.say(noRoute, PATIENCE_MS);
    signal.addEventListener("abort", () => this.shell.messages.unsay(noRoute), { once: true });
    const obstacle = await findObstacle(session.archive, settings, session.pawn.at, to, signal);
    if (signal.aborted) return null;
    this.shell.messages.say(obstacle === null ? texts.news.straightOn : blockedBy(obstacle));
    return obstacle;
  }

  /** Says how to get about. */
  #welcome(flies: boolean): void {
    const { capture, touch } = texts.news;
    const how = matchMedia("(pointer: coarse)").matches ? touch : capture;
    if (flies) this.shell.messages.say(texts.loading.found);
    else if (this.#mode === "walk") this.shell.messages.say(how);
  }

  #leave(): void {
    this.#ready = false;
    this.#minimap = null;
    this.#sheet?.close();
    this.#sheet = null;
    this.#first.end();
    this.#overlays.left();
    const { session } = this;
    this.session = null;
    if (session === null) return;
    this.canvas.scene.remove(session.world.group);
    this.shell.measure.clear();
    session.close();
  }

  #trouble(error: SlicewalkError | null): void {
    if (error !== null && error.kind !== "network") {
      // Reported once: damaged colours leave shapes grey, damaged pages block the pawn.
      if (this.#damage === null) this.shell.messages.say(texts.news.damage(error.message), DAMAGE_MS);
      this.#damage ??= error.message;
    } else if (error !== null) {
      this.#troubled = true;
      this.shell.messages.wait(texts.news.trouble(error.message));
    } else if (this.#troubled) {
      this.#troubled = false;
      this.shell.messages.wait(null);
      this.shell.messages.say(texts.news.back);
    }
  }

  /** Says why something was not opened; an archive in which one can walk stays. */
  #report(error: unknown): void {
    if (this.#ready) this.#refuse(error);
    else this.#fail(error);
  }

  /** Ways out beside those of the archive. */
  get #others(): Action[] {
    return this.#isKiosk ? [] : [{ label: texts.actions.other, act: () => this.#choose() }];
  }

  /** Says why something cannot be opened while the open archive stays. */
  #refuse(error: unknown): void {
    const message = error instanceof Error ? error.message : String(error);
    this.shell.messages.wait(null);
    const kind = error instanceof SlicewalkError ? error.kind : "page";
    this.shell.messages.trouble(kind, message, [
      { label: texts.actions.stay, act: () => this.shell.canvas.focus({ preventScroll: true }) },
      ...this.#others,
    ]);
  }

  /** Reports an error with possible actions; the picture stays. */
  #fail(error: unknown): void {
    const known = error instanceof SlicewalkError ? error : null;
    const message = error instanceof Error ? error.message : String(error);
    const kind = known?.kind ?? "page";
    this.#error = `${texts.errors[kind].title}: ${message}`;
    this.#ready = false;
    this.pointer.release();
    this.shell.messages.wait(null);
    const last = this.#last;
    // A kiosk begins anew for its next visitor.
    const place = this.session === null || this.#isKiosk ? (last?.place ?? null) : this.#place();
    const again = last === null ? [] : [{ label: texts.actions.again, act: () => void this.open(last.source, place) }];
    this.shell.messages.trouble(kind, message, [...again, ...this.#others]);
  }

  /** Where the pawn is, as part of an address. */
  #place(): Omit<Place, "archive"> | null {
    const pawn = this.session?.pawn;
    if (pawn === undefined || this.#first.shown) return null;
    return { at: pawn.at, look: { ...pawn.look }, mode: this.#mode, splats: this.#overlays.link };
  }

  // Inputs -----------------------------------------------------------------------------------------------------------------------

  get #view(): ModeOf {
    return this.#mode === "walk" && this.session?.pawn.flying === true ? this.#fly : this.#modes[this.#mode];
  }

  #key(code: string): void {
    const toggle = (mode: Mode): void => {
      const to = this.#mode === mode ? "walk" : mode;
      if (this.kiosk?.permits(to) ?? true) this.setMode(to);
    };
    const keys: Record<string, () => void> = {
      KeyM: () => toggle("plan"),
      KeyO: () => (this.#first.shown ? void this.#walkIn(null) : toggle("orbit")),
      KeyF: () => this.#flight(),
      KeyH: () => (this.#isKiosk ? undefined : this.shell.help()),
      KeyR: () => void this.#places.back(),
      Home: () => this.#home(),
      Enter: () => void this.#walkIn(null),
      Escape: () => this.shell.toolbars.show(null),
    };
    if (this.session !== null || code === "KeyH") keys[code]?.();
  }

  /** Back to where the walk began; while there already, to all of the scan. */
  #home(): void {
    const { start } = this.#places;
    const pawn = this.session?.pawn;
    if (pawn === undefined || start === null) return;
    if (!this.#first.shown && this.#mode === "walk" && distance(pawn.at, start.at) > 1) void this.#places.home();
    else this.#frameAll();
  }

  /** Shows the first view. */
  #frameAll(): void {
    const pawn = this.session?.pawn;
    if (pawn === undefined) return;
    this.setMode("orbit");
    this.#first.begin(!pawn.flying);
    this.#see();
  }

  /** Flies, or walks again; visitors of a kiosk do not fly through its walls. */
  #flight(): void {
    const pawn = this.session?.pawn;
    if (pawn === undefined || this.#isKiosk) return;
    if (this.#first.shown) this.setMode("walk");
    pawn.stop();
    pawn.flying = !pawn.flying;
    this.shell.toolbars.flying = pawn.flying;
    this.shell.messages.say(pawn.flying ? texts.news.flyOn : texts.news.flyOff);
  }

  #look({ heading, pitch }: Look): void {
    const look = this.session?.pawn.look;
    if (look) Object.assign(look, { heading: wrap(heading), pitch: clamp(pitch, -89, 89) });
  }

  #ray(x: number, y: number): Ray | null {
    return this.session && this.cameras.ray(x, y, this.session.world);
  }

  #hover(x: number, y: number): void {
    const ray = this.#ray(x, y);
    if (this.session && ray && this.shell.toolbars.panel === "measure") this.shell.measure.hover(this.session.archive, ray);
  }

  async #click(x: number, y: number, twice: boolean): Promise<void> {
    const { session } = this;
    const ray = this.#ray(x, y);
    if (session === null || ray === null) return;
    if (this.shell.toolbars.panel === "measure") await this.shell.measure.click(session.archive, session.world, ray);
    else if (this.#first.shown) {
      const place = await this.#places.floorAt(ray);
      if (place !== null) await this.#walkIn(place);
    } else await this.#places.send(ray, twice);
  }

  /** Goes to a place on the map, on the pawn's storey. */
  async #goThere([x, y]: readonly [number, number]): Promise<void> {
    const { session } = this;
    if (session === null) return;
    const z = session.pawn.at[2];
    await this.#places.send({ origin: [x, y, z + this.settings.height], direction: [0, 0, -1] }, true);
  }

  async #change(settings: Settings): Promise<void> {
    const before = this.settings;
    this.settings = settings;
    try {
      await this.session?.pawn.walker.set(walkerSettings(settings));
    } catch (error) {
      if (!(error instanceof SlicewalkError) || error.kind !== "invalid") return;
      this.settings = { ...settings, width: before.width, height: before.height, climb: before.climb, eye: before.eye };
      this.shell.messages.say(texts.settings.refused);
    }
    saveSettings(this.settings);
    this.shell.settings.show(this.settings);
    this.#theme();
    this.#see();
  }

  #theme(): void {
    const chosen = THEMES[this.settings.theme] ?? "auto";
    const theme = chosen !== "auto" ? chosen : this.#light.matches ? "light" : "dark";
    document.documentElement.dataset["theme"] = theme;
    this.canvas.paint(theme);
    this.cameras.field = this.settings.field;
    if (this.session !== null) this.canvas.sky.light(this.session.world.shading, this.#mode === "plan");
  }

  /** Starts or ends the use of the headset. */
  async #wear(): Promise<void> {
    const { headset } = this.canvas;
    const pawn = this.session?.pawn;
    if (pawn === undefined) return;
    try {
      if (headset.worn) await headset.leave();
      else {
        this.setMode("walk");
        await headset.enter(pawn.look.heading);
      }
    } catch (error) {
      this.shell.messages.say(texts.news.noHeadset(error instanceof Error ? error.message : String(error)));
    }
  }

  // Frames -----------------------------------------------------------------------------------------------------------------------

  #frame(seconds: number): void {
    this.#frames++;
    const { session } = this;
    if (session === null) {
      this.canvas.clear();
      return;
    }
    const { pawn, world, view } = session;
    const { headset } = this.canvas;
    const intent = joined([
      this.#keyboard.read(),
      readGamepad(),
      this.#sticks.read(),
      headset.read(),
      ...(this.kiosk ? [this.kiosk.intent] : []),
    ]);
    if (steers(intent) || this.#entering) this.kiosk?.touch();
    if (this.#first.shown && moves(intent) && this.#ready) void this.#walkIn(null);
    if (intent.turn !== 0 || intent.tilt !== 0) {
      this.#first.touch();
      this.#view.turn(intent.turn * TURN_PER_S * seconds, intent.tilt * TILT_PER_S * seconds);
    }
    this.#first.advance(seconds);
    const heading = this.cameras.heading(pawn.look);
    if (this.#ready && !this.#first.shown) pawn.step(seconds, intent, heading);
    const outside = this.#view.outside;
    // Seen from outside, a pawn faces where it walks.
    if (outside && !this.#first.shown && (intent.forward !== 0 || intent.right !== 0)) {
      pawn.look.heading = wrap(heading + (Math.atan2(intent.right, intent.forward) * 180) / Math.PI);
      this.cameras.orbit.target = pawn.at;
      this.cameras.framed = null;
    }
    const eye = pawn.eye(this.settings.eye, seconds);
    this.cameras.update(this.#mode, world, eye, pawn.look);
    if (world.moveOrigin(outside ? this.cameras.orbit.target : eye)) {
      this.cameras.update(this.#mode, world, eye, pawn.look);
      this.shell.measure.moved(world);
      this.#overlays.place();
    }
    // Visible pages load after those that the first step needs.
    if (headset.worn) Object.assign(pawn.look, headset.place(world, eye, this.settings.eye));
    const from = outside ? this.cameras.stand : eye;
    if (pawn.state.ticks > 0 || this.#first.shown) view.look(from);
    world.settle();
    void this.sight?.follow(pawn.at, this.settings);
    this.sight?.update(from, seconds);
    this.#places.watch(seconds);
    this.#stops.update(pawn, seconds);
    this.#seenTriangles = world.cull(this.canvas.camera, from);
    this.#overlays.follow(from, outside ? this.cameras.orbit.distance : null, this.cameras.focal(this.canvas.element.height));
    const metresHigh = this.cameras.orbit.distance;
    const isMarked = outside && !this.#first.shown;
    this.canvas.mark(isMarked, world, pawn.state, pawn.look, this.settings.width, metresHigh);
    this.#goal.show(world, pawn.way, pawn.obstacle, outside ? metresHigh : 0);
    this.#drawPlan(world, pawn.at[2]);
    const { min, max } = session.content;
    this.canvas.sky.follow(
      this.canvas.camera,
      this.#mode === "plan",
      from[2] - min[2],
      Math.hypot(max[0] - min[0], max[1] - min[1]),
    );
    this.canvas.show(this.#pictured(world, pawn, isMarked));
    this.canvas.render(performance.now(), this.#overlays.bringColours);
    this.#minimap?.update(pawn.at, pawn.look.heading);
  }

  /** All that the picture depends on, as a text. */
  #pictured(world: World, pawn: Pawn, isMarked: boolean): string {
    const { element, camera, quality, sky } = this.canvas;
    const all = [
      this.#mode,
      quality,
      sky.theme,
      [element.width, element.height],
      camera.matrixWorld.elements,
      camera.projectionMatrix.elements,
      [world.revision, world.group.visible, world.shading.shown],
      isMarked ? [...pawn.at, pawn.state.height, pawn.look.heading, this.settings.width] : null,
      [pawn.way, pawn.obstacle?.at],
      this.shell.measure.revision,
      [this.#sheet?.revision, this.#sheet?.group.visible],
      this.#overlays.revision,
    ];
    return all.join(";");
  }

  /** Draws the storey around the pawn, except while slices are shown. */
  #drawPlan(world: World, floor: number): void {
    const { cameras, shell, canvas } = this;
    const shows = this.#mode === "plan" && shell.toolbars.panel !== "slices";
    const onlyCut = this.sight !== null && this.sight.colouring !== "height";
    const pixelsHigh = canvas.element.clientHeight;
    const shown = { area: cameras.area, floor, theme: canvas.sky.theme, onlyCut, pixelsHigh };
    this.#sheet?.update(world, shows ? shown : null);
    world.group.visible = world.matter && (!shows || onlyCut);
    const step = this.#sheet?.step ?? 1;
    const pixels = (step * pixelsHigh) / cameras.orbit.distance;
    shell.plan.update(shows ? { step, pixels, cut: metres(floor + CUT_ABOVE_M) } : null);
  }

  /** The page for conversions. */
  #opener(): Opener {
    const page = this;
    return {
      open: (source) => page.open(source, null),
      fetch: (source) => page.#fetch(source),
      say: (text) => page.shell.messages.say(text),
      get archive() {
        return page.session?.archive ?? null;
      },
      get source() {
        return page.session?.source ?? null;
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
      get first() {
        return page.#first.shown;
      },
      setMode: (mode) => page.setMode(mode),
      frame: () => page.#frameAll(),
      goto: (place) => page.goto(place),
      walkTo: (place, arrived) => {
        const pawn = page.session?.pawn;
        if (pawn === undefined) return;
        pawn.flying = false;
        pawn.onArrival = arrived;
        void pawn.walkTo(place);
      },
      stop: () => {
        const pawn = page.session?.pawn;
        if (pawn === undefined) return;
        pawn.stop();
        page.#tellArrivals(pawn);
      },
    };
  }

  #see(): void {
    if (this.session === null) return;
    this.canvas.sky.light(this.session.world.shading, this.#mode === "plan");
    this.sight?.see(this.#mode, this.settings, QUALITIES[this.settings.quality] ?? "auto");
  }

  #colour(): void {
    if (this.session !== null) this.sight?.colour(this.settings);
  }

  #write(): void {
    const { session } = this;
    if (session === null) return;
    const { archive, pawn, crs } = session;
    const facts = { state: pawn.state, stats: archive.stats, crs, fps: this.#fps, triangles: this.#seenTriangles };
    this.shell.status.update(facts);
    this.shell.slices.update(pawn.at[2]);
    if (!this.#troubled && this.#ready && !this.canvas.lost) {
      const waits = this.#first.shown ? 0 : pawn.state.missing;
      const reason = this.#damage === null ? texts.loading.waiting(waits) : texts.loading.damaged(waits, this.#damage);
      if (waits > 0 || !this.#first.shown) this.shell.messages.wait(waits > 0 ? reason : null);
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
