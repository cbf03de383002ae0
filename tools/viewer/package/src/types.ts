/**
 * What the package offers. All lengths are metres, all coordinates those of the scan (z is up), all times seconds.
 *
 * The work is done in a Web Worker: each call posts a message, so nothing here blocks the page. Batches are typed arrays, one
 * question after the other; the arrays given are copied, those returned were moved and belong to the caller.
 */

/** A place or a direction: x, y, z. */
export type Vec3 = readonly [number, number, number];

/** Least and greatest corner. */
export interface Bounds {
  readonly min: Vec3;
  readonly max: Vec3;
}

/** Answers of {@link Archive.overlaps}. */
export const CLEAR = 0;
/** The box touches matter. */
export const HIT = 1;
/** The box touches none of the pages in memory; pages that are not loaded may hold matter. Never to be read as free. */
export const NOT_LOADED = 2;

/**
 * What went wrong:
 *
 * - `not-an-archive`: the first bytes are no slice archive, or one of a version that this engine does not read;
 * - `damaged`: bytes break a rule of the format (the message names part and rule);
 * - `replaced`: the archive changed on its host since it was opened; open it again;
 * - `network`: the host cannot be reached or refuses (the message has its status), after all attempts;
 * - `no-ranges`: the host ignores `Range` and the file is too large to be read whole;
 * - `out-of-memory`: the budget is too small for the archive's table of pages, or the browser has no more memory;
 * - `aborted`: by the caller's signal, or the archive was closed;
 * - `invalid`: an argument makes no sense;
 * - `engine`: a defect of the engine, or its worker cannot start.
 */
export type ErrorKind =
  "not-an-archive" | "damaged" | "replaced" | "network" | "no-ranges" | "out-of-memory" | "aborted" | "invalid" | "engine";

/** The only error that the package throws or rejects with. */
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

/** Options of `openArchive`. */
export interface OpenOptions {
  /**
   * Most bytes of pages, tables and bytes on their way in memory; 64 MiB unless given. Where a view shows an overview level, that
   * may take a quarter more.
   */
  budgetBytes?: number;
  /** Most requests under way at once; 6 unless given. */
  requests?: number;
  /** Gives up opening; the archive stays open if it is already. */
  signal?: AbortSignal;
  /** Passed on to `fetch`. */
  credentials?: RequestCredentials;
  /**
   * Where the worker and the engine come from, if not from beside this module: for bundlers and content security policies
   * that want it so. `wasm` may be a module that is compiled already.
   */
  worker?: () => Worker;
  wasm?: string | URL | WebAssembly.Module;
}

/** What the head of an archive says. */
export interface ArchiveInfo {
  /** The address it was opened from, or the name of the file. */
  readonly name: string;
  readonly fileBytes: number;
  /** Version of the format: "1.0". */
  readonly formatVersion: string;
  /** Edge of a pixel. */
  readonly pixelSize: number;
  readonly sliceHeight: number;
  /** Corner of pixel (0, 0) and bottom of slice 0. */
  readonly origin: Vec3;
  /** Least and greatest coordinates of the points; null without points. */
  readonly bounds: Bounds | null;
  /** Lowest and highest slice with matter; null without matter. */
  readonly slices: { readonly lowest: number; readonly highest: number } | null;
  /** Steepest floor (degrees): chosen when the scan was converted, part of the archive. */
  readonly maxSlope: number;
  readonly tolerance: number;
  readonly pointsRead: number;
  readonly pointsKept: number;
  readonly voxels: { readonly occupied: number; readonly obstacle: number; readonly coloured: number };
  readonly pages: number;
  /** Overview levels in the archive, 0 without. Level `n` has pixels of 4ⁿ times the size. */
  readonly levels: number;
}

/** Coordinate reference system and unit of the scan, from the metadata of the archive. */
export interface ArchiveReference {
  /** As the input stated it (WKT or a name); empty if unknown. */
  readonly crs: string;
  /** Unit of the input; archives are in metres. */
  readonly unit: { readonly name: string; readonly factor: number };
}

/** What streaming did so far. */
export interface Stats {
  /** Pages in memory, and their bytes. */
  readonly pages: { readonly resident: number; readonly bytes: number };
  /** Bytes in use of the budget, and the most at any moment. */
  readonly usedBytes: number;
  readonly peakBytes: number;
  readonly budgetBytes: number;
  /** Requests made, and bytes that came. */
  readonly requests: number;
  readonly bytesLoaded: number;
  /** Requests on their way now. */
  readonly pending: number;
  /** Pages loaded and evicted so far. */
  readonly loaded: number;
  readonly evicted: number;
  /** Pages that the last steps of all walkers waited for. */
  readonly missing: number;
  /** Pages of geometry still to be built for the open views. */
  readonly unbuilt: number;
  /** Drawn pages that wait for colours; requests made for colours and bytes that came of them, which count above as well. */
  readonly colours: { readonly missing: number; readonly requests: number; readonly bytes: number };
}

export interface ArchiveEvents {
  /** About four times a second while something changes. */
  stats: (stats: Stats) => void;
  /**
   * The host cannot be reached (kind `network`; `null` once it can be again), or a page, its colours or the overview level is
   * damaged and left out (kind `damaged`). A lasting error ends the archive.
   */
  trouble: (error: SlicewalkError | null) => void;
  /** The archive can no longer be used: replaced, damaged, or the worker died. Everything that was asked is rejected. */
  failed: (error: SlicewalkError) => void;
}

/** How a batch is answered. */
export interface BatchOptions {
  /**
   * Loads the pages that the answers need, a part of the batch after the other, and so answers everything. Without it the answer
   * is that of the pages in memory now.
   */
  load?: boolean;
  signal?: AbortSignal;
}

/** Hits of rays in full. */
export interface RayHits {
  /** Distance to the first matter; Infinity: nothing hit, NaN: not loaded. */
  readonly distances: Float64Array;
  /** Three numbers a ray: outward normal of the face; zeros where there is none. */
  readonly normals: Float64Array;
  /** 1 where the matter is an obstacle. */
  readonly obstacles: Uint8Array;
}

/** How far rays are free. */
export interface FarHits {
  /** Distance to the first matter, or the least that it can be; Infinity: nothing hit, NaN: not loaded. */
  readonly distances: Float64Array;
  /** 1 where pages are missing: an overview level says that there is no matter nearer. */
  readonly coarse: Uint8Array;
}

/** A plan of one storey, seen from above. */
export interface SliceMap {
  readonly width: number;
  readonly height: number;
  /** Row by row from the greatest y to the least: 0 nothing, 1 floor, 2 obstacle, 3 not loaded. */
  readonly cells: Uint8Array;
  /** Edge of a cell. */
  readonly cell: number;
  /** Corner of the picture with the least x and y. */
  readonly min: readonly [number, number];
}

/** An open archive. */
export interface Archive {
  readonly info: ArchiveInfo;
  /** The newest numbers, without waiting. */
  readonly stats: Stats;
  /** The reason why the archive can no longer be used. */
  readonly error: SlicewalkError | null;

  on<E extends keyof ArchiveEvents>(event: E, listener: ArchiveEvents[E]): () => void;

  /** Reads the metadata: one more request, once. */
  reference(): Promise<ArchiveReference>;

  /** Boxes N×6 (min, max) → N × {@link CLEAR}, {@link HIT} or {@link NOT_LOADED}. */
  overlaps(boxes: Float64Array, options?: BatchOptions): Promise<Uint8Array>;
  /** Sweeps N×9 (min, max, motion) → free share of the motion, 0 to 1; NaN: not loaded. */
  sweep(sweeps: Float64Array, options?: BatchOptions): Promise<Float64Array>;
  /** Rays N×7 (origin, direction, max) → distance; Infinity: nothing hit, NaN: not loaded. */
  cast(rays: Float64Array, options?: BatchOptions): Promise<Float64Array>;
  /**
   * As {@link cast}, of what is in memory: where pages are missing, the overview level that a view shows (`overview: true`) says how far
   * the ray is free at least. Never loads anything.
   */
  castFar(rays: Float64Array, options?: { signal?: AbortSignal }): Promise<FarHits>;
  /** As {@link cast}, with normals. */
  castHits(rays: Float64Array, options?: BatchOptions): Promise<RayHits>;
  /**
   * Boxes N×6 → height of the highest floor under the box's footprint, at or below its top, at any depth; -Infinity: no floor,
   * NaN: not loaded.
   */
  floor(boxes: Float64Array, options?: BatchOptions): Promise<Float64Array>;

  /** Loads what a pawn needs to stand in this box, and resolves when all of it is in memory. */
  load(box: Bounds, options?: { signal?: AbortSignal }): Promise<void>;

  /** Floor and obstacles between two heights, of the pages in memory now; at most 1024 cells an edge. */
  map(
    area: { min: readonly [number, number]; max: readonly [number, number] },
    heights: readonly [number, number],
    cells?: number,
  ): Promise<SliceMap>;

  /** A pawn. Pages around it are loaded ahead of its way. */
  walker(options: WalkerOptions): Promise<Walker>;

  /** Geometry around a camera, for drawing. */
  view(options: ViewOptions): View;

  /** Ends all walkers and views, gives up all requests and stops the worker. */
  close(): void;
}

// Walking ----------------------------------------------------------------------------------------------------------------------

/** The shape of a pawn: it stands on the middle of its bottom face. */
export type Body =
  | { readonly shape: "box"; readonly x: number; readonly y: number; readonly height: number }
  | { readonly shape: "cylinder"; readonly radius: number; readonly height: number };

/** What can be changed while a pawn walks. */
export interface WalkerSettings {
  /** 0.5 × 0.5 × 1.8 m unless given. A larger one that finds no room is refused (`invalid`). */
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
  /** Stops before ledges and voids deeper than this; walks over them and falls without it. */
  maxDrop?: number | null;
}

export interface WalkerOptions extends WalkerSettings {
  /** Where the feet are. */
  at: Vec3;
}

/** What a pawn is told to do for the time of a step. */
export interface WalkerInput {
  /** Direction across in world coordinates; a length below 1 means slower. */
  wish?: readonly [number, number];
  /** Walks straight to this place instead, and stands there. */
  toward?: readonly [number, number];
  /** Multiplies the walking speed (running: 2); 1 unless given, at most 100. */
  pace?: number;
  /** Jumps if the pawn stands. */
  jump?: boolean;
  /** Crouches, for as long as it is true and as there is no room to stand up. */
  crouch?: boolean;
  /** Flies, through walls as well; falls when it ends. */
  fly?: boolean;
  /** While flying: up (1) or down (-1). */
  lift?: number;
}

/** What a pawn is doing, as `window.slicewalk.state().ground` has it. */
export type Ground = "walking" | "falling" | "blocked" | "flying";

/** Why a pawn did not get where it wanted. */
export type Stop = "wall" | "steep" | "headroom" | "corner" | "inside" | "ledge" | "void";

export interface WalkerState {
  /** Middle of the bottom face. */
  readonly at: Vec3;
  readonly ground: Ground;
  /** Reason why the last step ended early, if so. */
  readonly stop: Stop | null;
  /** Speed across and along z over the last step (m/s); rising is positive. */
  readonly speed: number;
  readonly rise: number;
  readonly crouched: boolean;
  /** Height of the body now. */
  readonly height: number;
  /** Pages that the last step waited for: it stood still instead. */
  readonly missing: number;
  /** Ticks of 1/240 s that passed since the walker was made. */
  readonly ticks: number;
  /** Steps answered so far. */
  readonly steps: number;
}

/** What a walker did, to be replayed natively: `replay ARCHIVE RECORDING.json` of the engine crate. */
export interface WalkerRecording {
  readonly version: 1;
  readonly options: Required<WalkerSettings> & { at: Vec3 };
  /** Eight numbers a step: ticks that passed, wish x, wish y (of `toward`: the place), pace, lift, flags, and two kept free. Flags: 1 jump, 2 crouch, 4 fly, 8 toward. */
  readonly steps: readonly number[];
  /** Three numbers a step: the feet after it. */
  readonly path: readonly number[];
}

/** A pawn in the worker. Time passes in ticks of fixed length, so the way walked depends on the inputs, not on the frame rate. */
export interface Walker {
  /** The newest state that the worker told; changes when a step is answered. */
  readonly state: WalkerState;
  /**
   * Lets time pass (at most 0.25 s; the rest is dropped). Call it once a frame and go on at once: the state that it resolves to
   * is usually there before the next frame.
   */
  step(seconds: number, input: WalkerInput): Promise<WalkerState>;
  /** Puts the pawn elsewhere, at rest. */
  place(at: Vec3): Promise<WalkerState>;
  set(settings: WalkerSettings): Promise<WalkerState>;
  /** Begins a recording, here and at rest. */
  record(): Promise<void>;
  /** The recording so far. */
  recording(): Promise<WalkerRecording>;
  close(): void;
}

// Drawing ----------------------------------------------------------------------------------------------------------------------

export interface ViewOptions extends ViewSettings {
  /** A page was built, or built anew with more or less detail: it replaces the one with the same `id`. */
  onPage: (page: PageGeometry) => void;
  /**
   * Colours of a page came, after its geometry and again when more detail is wanted. They are read when nothing else is, and not
   * without this; those of an overview level when no page waits for any.
   */
  onColours?: (colours: PageColours) => void;
  /** A page is too far away: forget it. */
  onDrop: (id: number) => void;
}

/**
 * Colours of the matter of a page on a grid of `edge × edge` cells across and 64 slices, from the page's corner and bottom: a cell's
 * colours are those of the slices in its mask, from the lowest up. Made to be two textures.
 */
export interface PageColours {
  /** The page, as in {@link PageGeometry}. */
  readonly id: number;
  readonly edge: number;
  /** Four numbers a cell, row by row: slices 0 to 31 and 32 to 63 as masks, number of the cell's first colour, 0. */
  readonly cells: Uint32Array;
  /** Four bytes a colour: red, green, blue (sRGB), 255. */
  readonly colours: Uint8Array;
}

export interface ViewSettings {
  /** How far to see (m); 40 unless given. */
  radius?: number;
  /** Most triangles of all pages together; 1,000,000 unless given. Detail is lowered to keep it. */
  triangles?: number;
  /** Cells wider than this share of their distance are built finer, if the archive has more detail; 0.01 unless given. */
  detail?: number;
  /**
   * Also brings all of an overview level, if the archive has one: pages with `key.level` above 0. They hold the matter of the
   * pages too, coarsely: draw it only where no page is drawn. `radius` is lowered to where the level is as fine as `detail`
   * asks for. False unless given.
   */
  overview?: boolean;
}

export interface View {
  /** Where the camera is. Call it whenever it moved; the worker looks at the newest only. */
  look(at: Vec3): void;
  set(settings: ViewSettings): void;
  close(): void;
}

/**
 * Geometry of one page: the tops, undersides and sides of its spans as quads, equal neighbours joined.
 *
 * A vertex lies at `origin + scale · position`, computed in double precision where coordinates are large: give a mesh the
 * position `origin − yourOrigin` and the scale `scale`. Heights are rounded to `scale[2]`, a quarter of a cell: the drawing may
 * differ from what collides by that much.
 */
export interface PageGeometry {
  /** Names the page in this view. */
  readonly id: number;
  /** Place of the page: tile column and layer; of an overview level if `level` is above 0. */
  readonly key: { readonly tx: number; readonly ty: number; readonly layer: number; readonly level: number };
  /** Edge of a cell: the pixel size times a power of two. */
  readonly cell: number;
  readonly origin: Vec3;
  readonly scale: Vec3;
  /** Least and greatest corner of the matter. */
  readonly bounds: Bounds;
  /** Three a vertex (x, y in cells, z in steps). */
  readonly positions: Uint16Array;
  /** Four a vertex: the normal's x, y, z as 127, 0 or -127, and 0. */
  readonly normals: Int8Array;
  /**
   * Four a vertex: face (0 top, 1 underside, 2 side), obstacle (0 or 1), slope of the surface around it (degrees, tops of floors
   * and obstacles alike; 90 for sides), and 0. Heights and slices follow from z.
   */
  readonly attributes: Uint8Array;
  /** Three a triangle, counterclockwise seen from outside. Pages share this memory: do not write to it. */
  readonly indices: Uint32Array;
}
