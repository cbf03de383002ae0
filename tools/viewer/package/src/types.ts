/**
 * Public interface of the package. All lengths are in metres, coordinates are those of the scan (z is up), and times
 * are in seconds.
 *
 * A Web Worker does the work: each call posts a message, so nothing here blocks the page. Batches are typed arrays with
 * one query after another; places and directions are arrays of any kind. Arguments are copied, results are transferred and
 * belong to the caller.
 */

/** A place or direction: x, y, z. */
export type Vec3 = readonly [number, number, number];

/** Lowest and highest corner. */
export interface Bounds {
  readonly min: Vec3;
  readonly max: Vec3;
}

/** The shape touches no solid; results of {@link Archive.overlaps}. */
export const CLEAR = 0;
/** The shape touches solid. */
export const HIT = 1;
/**
 * The shape touches no solid in memory, but meets pages that are not loaded and may hold some. Never treat it as free.
 */
export const NOT_LOADED = 2;

/**
 * Kinds of errors:
 *
 * - `not-an-archive`: the first bytes are not those of a slice archive, or of a version that this engine does not read;
 * - `damaged`: bytes break a rule of the format (the message names part and rule);
 * - `replaced`: the archive changed on its host since it was opened; open it again;
 * - `network`: the host cannot be reached or refuses the request (the message has its status), after all attempts;
 * - `no-ranges`: the host ignores `Range` and the file is too large to be read whole;
 * - `out-of-memory`: the budget is too small for the archive's table of pages, or the browser is out of memory;
 * - `aborted`: by the caller's signal, or because the archive was closed;
 * - `invalid`: an argument is invalid, or of another type than stated here; the archive stays usable;
 * - `engine`: a defect of the engine, or its worker cannot start.
 */
export const ERROR_KINDS = [
  "not-an-archive",
  "damaged",
  "replaced",
  "network",
  "no-ranges",
  "out-of-memory",
  "aborted",
  "invalid",
  "engine",
] as const;

export type ErrorKind = (typeof ERROR_KINDS)[number];

/** The only error class that the package throws or rejects with. */
export class SlicewalkError extends Error {
  constructor(
    readonly kind: ErrorKind,
    message: string,
    options?: ErrorOptions,
  ) {
    super(message, options);
    this.name = "SlicewalkError";
  }
}

/** Tells errors of this package from others, and if kinds are given, those of these kinds. */
export function isSlicewalkError<K extends ErrorKind = ErrorKind>(
  thrown: unknown,
  ...kinds: readonly K[]
): thrown is SlicewalkError & { readonly kind: K } {
  return thrown instanceof SlicewalkError && (kinds.length === 0 || (kinds as readonly ErrorKind[]).includes(thrown.kind));
}

/** Options of `openArchive`. */
export interface OpenOptions {
  /**
   * Largest number of bytes of pages, tables and requests in flight; 64 MiB by default. An overview level that a view
   * shows may take a quarter more.
   */
  budgetBytes?: number;
  /** Largest number of concurrent requests, 1 or more; 6 by default, at most 64. */
  requests?: number;
  /** Cancels opening; an archive that is already open stays open. */
  signal?: AbortSignal;
  /** Passed on to `fetch`. */
  credentials?: RequestCredentials;
  /**
   * Source of the worker and the engine if it is not the folder of this module, for bundlers and content security
   * policies that require it. `wasm` may be a compiled module.
   */
  worker?: () => Worker;
  wasm?: string | URL | WebAssembly.Module;
}

/** Contents of an archive's head. */
export interface ArchiveInfo {
  /** The address that the archive was opened from, or the name of the file. */
  readonly name: string;
  readonly fileBytes: number;
  /** Version of the format, such as "1.0". */
  readonly formatVersion: string;
  /** Edge of a pixel. */
  readonly pixelSize: number;
  readonly sliceHeight: number;
  /** Corner of pixel (0, 0) and bottom of slice 0. */
  readonly origin: Vec3;
  /** Bounds of the points; null without points. */
  readonly bounds: Bounds | null;
  /** Lowest and highest occupied slice; null without any. */
  readonly slices: { readonly lowest: number; readonly highest: number } | null;
  /** Steepest floor (degrees), chosen when the scan was converted. */
  readonly maxSlope: number;
  readonly tolerance: number;
  readonly pointsRead: number;
  readonly pointsKept: number;
  readonly voxels: { readonly occupied: number; readonly obstacle: number; readonly coloured: number };
  readonly pages: number;
  /** Number of overview levels in the archive. Pixels of level `n` are 4ⁿ times as large. */
  readonly levels: number;
}

/** Coordinate reference system and unit of the scan, from the metadata of the archive. */
export interface ArchiveReference {
  /** As stated by the input (WKT or a name); empty if unknown. */
  readonly crs: string;
  /** Horizontal unit of the input; archives are in metres. The factor is null if it is unknown, or if inputs have several. */
  readonly unit: { readonly name: string; readonly factor: number | null };
}

/** Streaming statistics. */
export interface Stats {
  /** Pages in memory and their bytes. */
  readonly pages: { readonly resident: number; readonly bytes: number };
  /** Bytes of the budget in use, and the peak. */
  readonly usedBytes: number;
  readonly peakBytes: number;
  readonly budgetBytes: number;
  /** Requests made and bytes received. */
  readonly requests: number;
  readonly bytesLoaded: number;
  /** Requests in flight. */
  readonly pending: number;
  /** Pages loaded and evicted so far. */
  readonly loaded: number;
  readonly evicted: number;
  /** Pages that the last steps of all walkers waited for. */
  readonly missing: number;
  /** Pages of geometry still to be built for open views. */
  readonly unbuilt: number;
  /** Drawn pages that wait for colours; requests for colours and bytes received, also included in the counts above. */
  readonly colours: { readonly missing: number; readonly requests: number; readonly bytes: number };
}

export interface ArchiveEvents {
  /** About four times a second while something changes. */
  stats: (stats: Stats) => void;
  /**
   * The host cannot be reached (kind `network`; `null` once it can be again), or a page, its colours or the overview
   * level is damaged and left out (kind `damaged`). A permanent error ends the archive.
   */
  trouble: (error: SlicewalkError | null) => void;
  /** The archive can no longer be used: replaced, damaged, or the worker died. All pending calls are rejected. */
  failed: (error: SlicewalkError) => void;
}

/** Options of a batch. */
export interface BatchOptions {
  /**
   * Loads the pages that the answers need, one part of the batch at a time, so that every answer is known. Otherwise
   * the answers come from the pages in memory now.
   */
  load?: boolean;
  signal?: AbortSignal;
}

/** Full results of rays. */
export interface RayHits {
  /** Distance to the first solid; Infinity: no hit, NaN: not loaded. */
  readonly distances: Float64Array;
  /** Three numbers per ray: outward normal of the face; zeros without a hit. */
  readonly normals: Float64Array;
  /** 1 if the ray hit an obstacle. */
  readonly obstacles: Uint8Array;
}

/** Free distances along rays. */
export interface FarHits {
  /** Distance to the first solid, or a lower bound of it; Infinity: no hit, NaN: not loaded. */
  readonly distances: Float64Array;
  /** 1 if pages are missing and the distance is the lower bound from an overview level. */
  readonly coarse: Uint8Array;
}

/**
 * A shape at a place: a box between two corners, a body that stands on the middle of its bottom face, or a sphere around
 * its centre.
 */
export type PlacedShape =
  Bounds | (Body & { readonly at: Vec3 }) | { readonly shape: "sphere"; readonly radius: number; readonly at: Vec3 };

/** Options of a move along surfaces. */
export interface SlideOptions extends BatchOptions {
  /** Most contacts that it handles, 1 or more; 4 by default, at most 16. At the last one it ends. */
  iterations?: number;
}

/** A contact of a move. */
export interface Contact {
  /** Way moved until then. */
  readonly distance: number;
  /**
   * Outward normal of the surface; zeros if the shape was inside of solid before it moved. Then it does not move: place
   * it elsewhere.
   */
  readonly normal: Vec3;
  /** Whether the surface is an obstacle, or floor. */
  readonly obstacle: boolean;
}

/** Outcome of a move along surfaces. */
export interface Slide {
  /** Motion that the shape made: add it to its place. */
  readonly motion: Vec3;
  /** In the order of the way. */
  readonly contacts: readonly Contact[];
  /** Pages are not loaded ahead, so the move ended before them. Never with `load`. */
  readonly missing: boolean;
}

/** A plan of one storey, seen from above. */
export interface SliceMap {
  readonly width: number;
  readonly height: number;
  /** Row by row from the greatest y to the least: 0 empty, 1 floor, 2 obstacle, 3 not loaded. */
  readonly cells: Uint8Array;
  /** Edge of a cell. */
  readonly cell: number;
  /** Corner of the map with the least x and y. */
  readonly min: readonly [number, number];
}

/** An open archive. */
export interface Archive {
  readonly info: ArchiveInfo;
  /** Latest statistics, without waiting. */
  readonly stats: Stats;
  /** The reason why the archive can no longer be used. */
  readonly error: SlicewalkError | null;

  on<E extends keyof ArchiveEvents>(event: E, listener: ArchiveEvents[E]): () => void;

  /** Reads the metadata, with one request the first time. */
  reference(): Promise<ArchiveReference>;

  /** All bytes of the archive, such as to save it; fails with `replaced` if its host has another version now. */
  file(options?: { signal?: AbortSignal }): Promise<Blob>;

  /** Boxes N×6 (min, max) → N × {@link CLEAR}, {@link HIT} or {@link NOT_LOADED}. */
  overlaps(boxes: Float64Array, options?: BatchOptions): Promise<Uint8Array>;
  /** Spheres N×4 (centre, radius) → answers like those of {@link overlaps}. */
  overlapsSpheres(spheres: Float64Array, options?: BatchOptions): Promise<Uint8Array>;
  /** Upright cylinders N×5 (middle of the bottom face, radius, height) → answers like those of {@link overlaps}. */
  overlapsCylinders(cylinders: Float64Array, options?: BatchOptions): Promise<Uint8Array>;
  /** Sweeps N×9 (min, max, motion) → free fraction of the motion, 0 to 1; NaN: not loaded. */
  sweep(sweeps: Float64Array, options?: BatchOptions): Promise<Float64Array>;
  /** Rays N×7 (origin, direction, max) → distance; Infinity: no hit, NaN: not loaded. */
  cast(rays: Float64Array, options?: BatchOptions): Promise<Float64Array>;
  /**
   * Casts rays like {@link cast}, but only against what is in memory: where pages are missing, the overview level that
   * a view shows (`overview: true`) gives a lower bound of the free distance. Never loads anything.
   */
  castFar(rays: Float64Array, options?: { signal?: AbortSignal }): Promise<FarHits>;
  /** Casts rays like {@link cast}, with normals. */
  castHits(rays: Float64Array, options?: BatchOptions): Promise<RayHits>;
  /**
   * Boxes N×6 → height of the highest floor below the box's footprint, at or below its top, at any depth; -Infinity: no
   * floor, NaN: not loaded.
   */
  floor(boxes: Float64Array, options?: BatchOptions): Promise<Float64Array>;

  /**
   * Moves a shape until it meets solid, and on along it, as character controllers do: against a wall along the wall,
   * between two walls along their crease, in a corner not at all. Never ends in solid that the shape was not in before,
   * nor moves farther than `motion` is long. Gravity, steps and slopes are the caller's; a {@link walker} has them.
   */
  moveAndSlide(shape: PlacedShape, motion: Vec3, options?: SlideOptions): Promise<Slide>;

  /** Loads the pages that a pawn needs to stand in this box; resolves once all of them are in memory. */
  load(box: Bounds, options?: { signal?: AbortSignal }): Promise<void>;

  /** Floor and obstacles between two heights, from the pages in memory now; 1 to 1024 cells per edge, 512 by default. */
  map(
    area: { min: readonly [number, number]; max: readonly [number, number] },
    heights: readonly [number, number],
    cells?: number,
  ): Promise<SliceMap>;

  /**
   * Boxes N×6 (min, max) around all solid, from the table of pages: nothing is loaded. Each has the width of a page; of
   * archives with more than 10,000 columns of pages, only some columns are listed.
   */
  pageBoxes(): Promise<Float64Array>;

  /** Creates a pawn. Pages are loaded ahead of it. */
  walker(options: WalkerOptions): Promise<Walker>;

  /** Creates walkers that keep out of each other. Pages are loaded ahead of them. */
  crowd(options: CrowdOptions): Promise<Crowd>;

  /** Creates a view: geometry around a camera, for drawing. */
  view(options: ViewOptions): View;

  /** Ends all walkers and views, cancels all requests and stops the worker. */
  close(): void;
}

// Walking ----------------------------------------------------------------------------------------------------------------------

/** Shape of a pawn, which stands on the middle of its bottom face. */
export type Body =
  | { readonly shape: "box"; readonly x: number; readonly y: number; readonly height: number }
  | { readonly shape: "cylinder"; readonly radius: number; readonly height: number };

/** Settings that can change while a pawn walks. */
export interface WalkerSettings {
  /** 0.5 × 0.5 × 1.8 m by default. A larger body that does not fit is refused (`invalid`). */
  body?: Body;
  /** Highest step (0.35). */
  climb?: number;
  /** Walking speed (1.4 m/s). */
  speed?: number;
  /** Acceleration downwards (9.81 m/s²). */
  gravity?: number;
  /** Height of a jump (0.5). */
  jump?: number;
  /** Height while crouching (60 % of the body's), never below the climb height. */
  crouchHeight?: number;
  /** Stops at ledges and voids deeper than this; by default the pawn walks over them and falls. */
  maxDrop?: number | null;
}

export interface WalkerOptions extends WalkerSettings {
  /** Position of the feet. */
  at: Vec3;
}

/** Input of a pawn for the time of a step. */
export interface WalkerInput {
  /** Horizontal direction in world coordinates; a length below 1 means slower. */
  wish?: readonly [number, number];
  /** Walks straight to this place instead, and stops there. */
  toward?: readonly [number, number];
  /** Walks along the route found last instead, and stops at its end. */
  follow?: boolean;
  /** Factor of the walking speed (running: 2); 1 by default, at most 100. */
  pace?: number;
  /** Jumps if the pawn stands. */
  jump?: boolean;
  /** Crouches while true, and until there is room to stand up. */
  crouch?: boolean;
  /** Flies, also through walls; falls afterwards. */
  fly?: boolean;
  /** While flying: up (1) or down (-1). */
  lift?: number;
}

/** Activity of a pawn, also in `window.slicewalk.state().ground`. */
export type Ground = "walking" | "falling" | "blocked" | "flying";

/** What blocked a pawn. */
export type Stop = "wall" | "steep" | "headroom" | "corner" | "inside" | "ledge" | "void";

export interface WalkerState {
  /** Middle of the bottom face. */
  readonly at: Vec3;
  readonly ground: Ground;
  /** What ended the last step early, if anything. */
  readonly stop: Stop | null;
  /** Horizontal and vertical speed over the last step (m/s); rising is positive. */
  readonly speed: number;
  readonly rise: number;
  readonly crouched: boolean;
  /** Current height of the body. */
  readonly height: number;
  /** Pages that the last step waited for; the pawn stood still. */
  readonly missing: number;
  /** Ticks of 1/240 s that passed since the walker was made. */
  readonly ticks: number;
  /** Steps answered so far. */
  readonly steps: number;
  /** Places of the route that lie ahead; 0 without one, and at its end. */
  readonly ahead: number;
}

/** A way on foot, which a walker has followed already. */
export interface Route {
  /** Places to go to in order, straight from one to the next. */
  readonly points: readonly Vec3[];
  /** Length of the lines between them, heights included (m). */
  readonly length: number;
}

/** Why there is no route: `too-far` means that the search was given up. */
export type RouteRefusal = "not-standing-from" | "not-standing-to" | "not-connected" | "too-far";

/** Recording of a walker, for a native replay with `replay ARCHIVE RECORDING.json` of the engine crate. */
export interface WalkerRecording {
  readonly version: 1;
  readonly options: Required<WalkerSettings> & { at: Vec3 };
  /**
   * Eight numbers per step: ticks that passed, wish x, wish y (of `toward`: the place), pace, lift, flags, z, and one
   * reserved. Flags: 1 jump, 2 crouch, 4 fly, 8 toward, 16 moved to the place x, y, z by {@link Walker.place}. Following a
   * route adds a row for each place on the way.
   */
  readonly steps: readonly number[];
  /** Three numbers per step: the feet after it. */
  readonly path: readonly number[];
}

/**
 * A pawn in the worker. Time passes in ticks of fixed length, so the path depends on the inputs, not on the frame rate.
 */
export interface Walker {
  /** Latest state reported by the worker; changes when a step is answered. */
  readonly state: WalkerState;
  /**
   * Advances by `seconds`, 0 or more, and at most 0.25; the rest is dropped. Without an input the pawn stands. Call it once
   * per frame without awaiting it: the state that it resolves to usually arrives before the next frame.
   */
  step(seconds: number, input?: WalkerInput): Promise<WalkerState>;
  /** Moves the pawn elsewhere, within ±10⁹ m, at rest. */
  place(at: Vec3): Promise<WalkerState>;
  /** Changes the settings that are named, in the order of the calls. One that is refused changes nothing. */
  set(settings: WalkerSettings): Promise<WalkerState>;
  /**
   * Finds a way on foot to a place, without drops from which the pawn could not return, as `slicetool route` does:
   * a start or an end where it cannot stand is moved by up to 0.5 m. Loads the pages that it needs, and lets steps
   * through meanwhile. `step` with `follow` walks it; a pawn that has moved since begins from where it is.
   */
  route(to: Vec3, options?: { signal?: AbortSignal }): Promise<Route | RouteRefusal>;
  /** Begins a recording, here and at rest. */
  record(): Promise<void>;
  /** The recording so far. */
  recording(): Promise<WalkerRecording>;
  close(): void;
}

/** Settings of all walkers of a crowd, and where each of them begins. */
export interface CrowdOptions extends Omit<WalkerSettings, "jump" | "crouchHeight"> {
  /** Positions of the feet, N×3; 1 to 1000 walkers. Those that overlap part. */
  at: Float64Array;
}

/** What a walker of a crowd does, as numbers in {@link CrowdState.activities}. */
export const CROWD_ACTIVITIES = ["walking", "falling", "blocked", "arrived"] as const;

export interface CrowdState {
  /** N×3: middle of the bottom face of each walker. */
  readonly places: Float64Array;
  /** One index into {@link CROWD_ACTIVITIES} per walker. */
  readonly activities: Uint8Array;
  /** Pages that walkers waited for in the last step; these stood still. */
  readonly missing: number;
}

/**
 * Walkers that keep out of each other, make way in doors, and settle around a common goal. Time passes in ticks of 1/60 s.
 * Paths depend on the inputs alone, like that of a single walker.
 */
export interface Crowd {
  /** Latest state reported by the worker; changes when a step is answered. */
  readonly state: CrowdState;
  /**
   * Advances by `seconds`, 0 or more, and at most 0.25; the rest is dropped. `wishes` has three numbers per walker: x and y
   * of a direction (shorter than 1: slower), and 0; or x and y of a place to go to, and 1.
   */
  step(seconds: number, wishes: Float64Array): Promise<CrowdState>;
  close(): void;
}

// Drawing ----------------------------------------------------------------------------------------------------------------------

export interface ViewOptions extends ViewSettings {
  /** A page was built or rebuilt with another detail: it replaces the one with the same `id`. */
  onPage: (page: PageGeometry) => void;
  /**
   * Colours of a page arrived, after its geometry and again when more detail is needed. Without this callback no
   * colours are read; they are read only while nothing else is in flight, and those of an overview level once no page
   * waits for colours.
   */
  onColours?: (colours: PageColours) => void;
  /** A page is too far away: drop it. */
  onDrop: (id: number) => void;
}

/**
 * Colours of a page's solid on a grid of `edge × edge` cells and 64 slices, from the page's corner and bottom. A cell's
 * colours are those of the slices in its mask, from the lowest up. Made for two textures.
 */
export interface PageColours {
  /** The page, as in {@link PageGeometry}. */
  readonly id: number;
  readonly edge: number;
  /** Four numbers per cell, row by row: slices 0 to 31 and 32 to 63 as masks, index of the cell's first colour, 0. */
  readonly cells: Uint32Array;
  /** Four bytes per colour: red, green, blue (sRGB), 255. */
  readonly colours: Uint8Array;
}

export interface ViewSettings {
  /** Viewing distance (m); 40 by default. */
  radius?: number;
  /** Largest number of triangles of all pages together; 1,000,000 by default. Detail is lowered to stay within it. */
  triangles?: number;
  /**
   * Cells wider than this fraction of their distance are built finer if the archive has more detail; 0.01 by default.
   */
  detail?: number;
  /**
   * Also builds all of an overview level, if the archive has one: pages with `key.level` above 0. They contain the
   * pages' solid, too, coarsely: draw them only where no page is drawn. `radius` is lowered to where the level is as
   * fine as `detail` requires. False by default.
   */
  overview?: boolean;
  /**
   * Draws exactly what collides. By default surfaces are smooth: tops and undersides of neighbouring cells meet at the
   * mean of their heights if these differ by less than a pawn climbs, and holes of single cells are closed.
   */
  blocks?: boolean;
}

export interface View {
  /** Sets the position of the camera. Call it after every move; the worker uses only the latest position. */
  look(at: Vec3): void;
  set(settings: ViewSettings): void;
  close(): void;
}

/**
 * Geometry of one page: the tops, undersides and sides of its spans as quads, with equal neighbours joined.
 *
 * A vertex lies at `origin + scale · position`, which needs double precision where coordinates are large: give a mesh
 * the position `origin − yourOrigin` and the scale `scale`. Heights are rounded to a quarter of a cell and, unless the
 * view draws blocks, averaged with those beside them; the drawing differs from the collision geometry by that much.
 */
export interface PageGeometry {
  /** Identifies the page in this view. */
  readonly id: number;
  /** Position of the page: tile column and layer; of an overview level if `level` is above 0. */
  readonly key: { readonly tx: number; readonly ty: number; readonly layer: number; readonly level: number };
  /** Edge of a cell: the pixel size times a power of two. */
  readonly cell: number;
  readonly origin: Vec3;
  readonly scale: Vec3;
  /** Lowest and highest corner of the solid. */
  readonly bounds: Bounds;
  /** Three per vertex (x, y in cells, z in steps). */
  readonly positions: Uint16Array;
  /** Four per vertex: the normal's x, y, z times 127, and 0. */
  readonly normals: Int8Array;
  /**
   * Four per vertex: face (0 top, 1 underside, 2 side), obstacle (0 or 1), slope of the surrounding surface (degrees,
   * tops of floors and obstacles alike; 90 for sides), and 0. Heights and slices follow from z.
   */
  readonly attributes: Uint8Array;
  /** Three per triangle, counterclockwise seen from outside. Pages share this memory: do not write to it. */
  readonly indices: Uint32Array;
}
