// Visible surroundings of the pawn: how far, in which colours, and between which heights.

import type { Bounds, Vec3 } from "slicewalk";
import type { Mode } from "./address";
import type { Canvas } from "./canvas";
import { add, distance, flat, standing, type Ray } from "./geometry";
import type { Cameras } from "./scene/cameras";
import type { Colouring, Effort } from "./scene/material";
import type { Session } from "./session";
import type { QUALITIES, Settings } from "./settings";
import type { Shell } from "./ui/shell";

/** The roof is cut this far below the ceiling, and at most this far above the feet. */
const CUT_BELOW_M = 0.15;
const CUT_ABOVE_M = 2;
const CEILING_M = 30;
/** Width of the box that looks for the ceiling, relative to the pawn's. */
const SLIM = 0.6;
/** Distance walked after which the ceiling is looked for again. */
const WAY_M = 0.3;
const FAR_M = 1e9;
const EVERYWHERE: Bounds = { min: [-FAR_M, -FAR_M, -FAR_M], max: [FAR_M, FAR_M, FAR_M] };
/** Far plane of the cameras. */
const FAR_SEEN_M = 4000;
/** Viewing distance until the pawn has made its first steps: what it walks on is loaded before what is far away. */
const FIRST_M = 4;
const FIRST_STEPS = 10;
/** Viewing distance until the whole scan is drawn from an overview level, unless none arrives for this time (s). */
const OUTLINE_M = 10;
const OUTLINE_S = 5;
/**
 * Initial number of triangles, and the range within which it adapts to the speed of the graphics (frames per second).
 */
const FIRST_TRIANGLES = 300_000;
const MOST_TRIANGLES = 1_000_000;
const LEAST_TRIANGLES = 100_000;
/** Width of cells seen from outside, relative to their distance: all of a storey at one detail. */
const OUTSIDE_DETAIL = 0.004;
const WALK_DETAIL = 0.01;
const SLOW_FPS = 18;
const FAST_FPS = 45;
/** The finish waits until the view has rested for so long where graphics are slow (s). */
const REST_S = 0.5;
/** Archives of fewer bytes are loaded whole soon, and then seen as far as this. */
const SMALL_BYTES = 16 << 20;
const SMALL_M = 150;
/** Roofs are cut off only where the pawn is seen from near. */
const ROOF_M = 60;

export class Sight {
  colouring: Colouring = "height";
  #mode: Mode = "walk";
  #roofZ = FAR_M;
  #from: Vec3 | null = null;
  #radius = FIRST_M;
  #triangles = FIRST_TRIANGLES;
  #outlined: boolean;
  #overview = 0;
  #idleS = 0;
  #wanted: (typeof QUALITIES)[number] = "auto";
  #slow: boolean;
  #restsS = 0;
  #seen = "";
  #outside = true;
  #blocks = false;
  #compiling = false;

  constructor(
    readonly session: Session,
    readonly shell: Shell,
    readonly cameras: Cameras,
    readonly canvas: Canvas,
  ) {
    this.#slow = canvas.isSoftware;
    this.#outlined = session.archive.info.levels === 0;
  }

  /** Sets the viewing distance of the engine and the shader for a view from inside, or `outside` from `distance`. */
  see(mode: Mode, settings: Settings, quality: (typeof QUALITIES)[number]): void {
    this.#mode = mode;
    this.#from = null;
    this.#wanted = quality;
    const { distance } = this.cameras.orbit;
    const { view, world } = this.session;
    const outside = mode !== "walk";
    // In a walk, most of the triangles lie behind the pawn.
    if (outside !== this.#outside) this.#triangles = FIRST_TRIANGLES;
    this.#outside = outside;
    // Measured from the camera, which is this far away.
    const radius = outside ? Math.max(settings.radius, distance) + distance : this.#around(settings.radius);
    this.#radius = radius;
    view.set({
      radius: this.#loaded,
      detail: outside ? OUTSIDE_DETAIL : WALK_DETAIL,
      triangles: Math.round(this.#triangles),
      blocks: this.#blocks,
    });
    const { uniforms } = world.shading;
    // Beyond the pages, an overview level shows the rest.
    uniforms.far.value = Math.max(2 * radius, this.#extent, 80);
    uniforms.fogShare.value = outside ? 0 : 1;
    this.colour(settings);
  }

  /**
   * Draws less where the graphics are slow, and more where they have time, by frames a second; null while nothing moves. Call it
   * once a second.
   */
  adapt(fps: number | null): void {
    const { view, world } = this.session;
    const slow = fps !== null && fps < SLOW_FPS && world.triangles > this.#triangles / 2;
    const fast = fps !== null && fps > FAST_FPS;
    if (slow && this.#triangles <= LEAST_TRIANGLES) this.#slow = true;
    if (slow) this.#triangles = Math.max(LEAST_TRIANGLES, this.#triangles / 2);
    else if (fast) this.#triangles = Math.min(MOST_TRIANGLES, this.#triangles * 1.5);
    if (this.#settled) this.#outline();
    view.set({ radius: this.#loaded, triangles: Math.round(this.#triangles) });
  }

  /** Checks whether the outline is drawn: everything that arrived, with nothing new for a second. */
  #outline(): void {
    const { archive, world } = this.session;
    const { overview } = world.counts;
    const { unbuilt, pending } = archive.stats;
    const idle = unbuilt === 0 && world.waiting === 0 && overview === this.#overview;
    this.#overview = overview;
    this.#idleS = idle && pending === 0 ? this.#idleS + 1 : 0;
    this.#outlined ||= (idle && overview > 0) || this.#idleS > OUTLINE_S;
  }

  /** How far pages are loaded: first what the pawn walks on, then the outline, then the rest. */
  get #loaded(): number {
    const begins = !this.#settled && this.#mode === "walk";
    const most = begins ? FIRST_M : this.#outlined ? this.#radius : OUTLINE_M;
    return Math.min(most, this.#radius);
  }

  /** How far an overview level is shown (m), 0 without one. */
  get #extent(): number {
    const { bounds, levels } = this.session.archive.info;
    return bounds === null || levels === 0 ? 0 : Math.min(FAR_SEEN_M, distance(bounds.min, bounds.max));
  }

  get #settled(): boolean {
    return this.cameras.framed !== null || this.session.pawn.state.steps >= FIRST_STEPS;
  }

  /** Heights between which solid is shown. */
  get cut(): readonly [number, number] {
    const { slice, roof } = this.shell.slices.choice;
    const { info } = this.session.archive;
    if (slice !== null && this.#showsSlices) {
      const bottom = info.origin[2] + slice * info.sliceHeight;
      return [bottom, bottom + info.sliceHeight];
    }
    // A section box says itself what is cut off.
    const isFree = this.cameras.framed === null && this.shell.section.box === null;
    const cuts = roof && this.#mode !== "walk" && isFree;
    return [-FAR_M, cuts && this.cameras.orbit.distance < ROOF_M ? this.#roofZ : FAR_M];
  }

  colour(settings: Settings): void {
    const { world } = this.session;
    world.shading.colouring = this.#showsSlices ? "slice" : this.colouring;
    world.shading.uniforms.slope.value = settings.slope;
    const { min, max } = this.session.content;
    this.shell.colours.show([min[2], max[2]], settings.slope);
  }

  /** How far one sees: a small archive without overview levels is seen whole, up to a limit. */
  #around(radius: number): number {
    const { min, max } = this.session.content;
    const { levels, fileBytes } = this.session.archive.info;
    const small = levels === 0 && fileBytes < SMALL_BYTES;
    return small ? Math.max(radius, Math.min(distance(min, max), SMALL_M)) : radius;
  }

  /** Draws what collides instead of smooth surfaces. */
  showBlocks(blocks: boolean): void {
    this.#blocks = blocks;
    this.session.view.set({ blocks });
  }

  /** Chooses how much the picture may cost: where graphics are slow, more only while the view rests. */
  #rate(from: Vec3, seconds: number): void {
    const { look } = this.session.pawn;
    const { orbit } = this.cameras;
    const seen = [...from, look.heading, look.pitch, orbit.look.heading, orbit.look.pitch].map((n) => n.toFixed(3)).join();
    this.#restsS = seen === this.#seen ? this.#restsS + seconds : 0;
    this.#seen = seen;
    const best = this.canvas.isSoftware ? "finished" : "smooth";
    const free = this.#wanted === "best" || !this.#slow || this.#restsS > REST_S;
    const quality = this.#wanted === "lowest" || !free ? "lowest" : best;
    // A view that rests is not drawn again with other pixels.
    if (quality !== this.canvas.quality) {
      this.canvas.quality = quality;
      if (!this.canvas.isSoftware) this.canvas.resize();
    }
    const [low, high] = this.cut;
    const scan = this.colouring === "scan" && !this.#showsSlices;
    const cut = low > -FAR_M || high < FAR_M || this.shell.section.box !== null;
    void this.#take({ scan, fine: quality !== "lowest", cut });
  }

  /** Takes other shaders, once they are compiled. */
  async #take(effort: Effort): Promise<void> {
    const { world } = this.session;
    const isSame = ({ scan, fine, cut }: Effort): boolean => scan === effort.scan && fine === effort.fine && cut === effort.cut;
    if (this.#compiling || isSame(world.shading.effort)) return;
    this.#compiling = true;
    try {
      await this.canvas.prepare(world.shading.of(effort));
    } finally {
      this.#compiling = false;
    }
    world.effort = effort;
    this.canvas.refresh();
  }

  /** Updates the shader's heights, which are relative to the moving local origin. */
  update(from: Vec3, seconds: number): void {
    this.#rate(from, seconds);
    const { world, archive, pawn } = this.session;
    const { info } = archive;
    const { uniforms } = world.shading;
    const [low, high] = this.cut;
    const z = world.origin[2];
    uniforms.cut.value.set(low - z, high - z);
    const box = this.shell.section.box ?? EVERYWHERE;
    uniforms.boxLow.value.copy(world.local(box.min));
    uniforms.boxHigh.value.copy(world.local(box.max));
    const { min, max } = this.session.content;
    uniforms.heights.value.set(min[2] - z, max[2] - z);
    uniforms.slicing.value.set(info.origin[2] - z, info.sliceHeight);
    const slice = Math.floor((pawn.at[2] - info.origin[2] + 1e-6) / info.sliceHeight);
    const bottom = info.origin[2] + slice * info.sliceHeight - z;
    uniforms.pawnSlice.value.set(bottom, bottom + info.sliceHeight);
  }

  /** Looks for the ceiling above the pawn after it has moved. */
  async follow(at: Vec3, settings: Settings): Promise<void> {
    const near = this.#from !== null && distance(at, this.#from) < WAY_M;
    const mode = this.#mode;
    if (mode === "walk" || near) return;
    this.#from = at;
    // Unlike a ray, a box does not slip through a sparse ceiling; a slim one keeps away from walls.
    const [low, high] = [at[2] + settings.height / 2, at[2] + settings.height];
    const body = flat(standing([at[0], at[1], low], SLIM * settings.width, high - low));
    const up = new Float64Array([...body, 0, 0, CEILING_M]);
    const share = (await this.session.archive.sweep(up, { load: true }).catch(() => null))?.[0] ?? NaN;
    const ceiling = share < 1 ? high + share * CEILING_M : Infinity;
    // Under the open sky nothing hides the pawn from the side.
    const opened = ceiling === Infinity && mode === "orbit";
    this.#roofZ = opened ? FAR_M : Math.min(ceiling - CUT_BELOW_M, at[2] + CUT_ABOVE_M);
    this.colour(settings);
  }

  /** Starts a ray where it enters the visible range, so that it does not hit what was cut off. */
  enter(ray: Ray): Ray {
    const [, top] = this.cut;
    const { origin, direction } = ray;
    const { min, max } = this.shell.section.box ?? EVERYWHERE;
    const high = [max[0], max[1], Math.min(max[2], top)];
    const far = ([0, 1, 2] as const).map((axis) => {
      const side = direction[axis] < 0 ? (high[axis] ?? FAR_M) : min[axis];
      return direction[axis] === 0 ? 0 : (side - origin[axis]) / direction[axis];
    });
    return { origin: add(origin, direction, Math.max(0, ...far)), direction };
  }

  get #showsSlices(): boolean {
    return this.shell.toolbars.panel === "slices";
  }
}
