/** Messages between page and worker. */

import type { Fault } from "./fault.js";
import type { PageMessage, PaintMessage } from "./messages.js";
import type { Stats } from "./types.js";

/** Opens an archive: the first message to a worker. */
export interface Open {
  readonly call: "open";
  readonly source: string | Blob;
  readonly wasm: string | WebAssembly.Module | undefined;
  readonly budgetBytes: number;
  readonly requests: number;
  readonly credentials: RequestCredentials | undefined;
}

export type BatchKind = "overlaps" | "spheres" | "cylinders" | "sweep" | "cast" | "far" | "floor";

/** A move along surfaces; the shape has six numbers for a box, five for a cylinder, four for a sphere. */
export interface Sliding {
  readonly shape: Float64Array;
  readonly motion: Float64Array;
  readonly contacts: number;
}

export type SceneSettings = readonly [radius: number, triangles: number, detail: number, overview: boolean, blocks: boolean];

/** Calls with an answer. */
export type Call =
  | Open
  | { readonly call: "reference" }
  | { readonly call: "file" }
  | { readonly call: "boxes" }
  | { readonly call: "batch"; readonly kind: BatchKind; readonly rows: Float64Array; readonly load: boolean }
  | ({ readonly call: "slide"; readonly load: boolean } & Sliding)
  | { readonly call: "load"; readonly box: Float64Array }
  | { readonly call: "map"; readonly area: Float64Array; readonly cells: number }
  | { readonly call: "walker"; readonly settings: Float64Array; readonly at: Float64Array }
  | { readonly call: "place"; readonly walker: number; readonly at: Float64Array }
  | { readonly call: "crowd"; readonly settings: Float64Array; readonly places: Float64Array }
  | { readonly call: "step-crowd"; readonly crowd: number; readonly seconds: number; readonly wishes: Float64Array }
  | { readonly call: "route"; readonly walker: number; readonly to: Float64Array }
  | { readonly call: "settings"; readonly walker: number; readonly settings: Float64Array }
  | { readonly call: "record"; readonly walker: number }
  | { readonly call: "recording"; readonly walker: number }
  | { readonly call: "view"; readonly settings: SceneSettings; readonly colours: boolean };

/** Messages without an answer. */
export type Note =
  | { readonly note: "look"; readonly view: number; readonly at: Float64Array }
  | { readonly note: "view"; readonly view: number; readonly settings: SceneSettings }
  | { readonly note: "forget"; readonly name: number }
  | { readonly note: "abort"; readonly id: number };

/**
 * A step and its answer, whose fault comes as for any call. They come every frame, so they are arrays: browsers take
 * longer for objects. The numbers are those of an `InputMessage` and of a `StateMessage`.
 */
export type Step = [id: number, walker: number, seconds: number, ...input: number[]];
export type Stepped = [id: number, ...state: number[]];

export type ToWorker = (Call & { readonly id: number }) | Note | Step;

/** A built page. */
export interface PageEvent {
  readonly event: "page";
  readonly view: number;
  readonly page: PageMessage;
  readonly positions: Uint16Array;
  readonly normals: Int8Array;
  readonly attributes: Uint8Array;
}

/** Colours of a built page. */
export interface ColoursEvent {
  readonly event: "colours";
  readonly paint: PaintMessage;
  readonly cells: Uint32Array;
  readonly colours: Uint8Array;
}

export type FromWorker =
  | Stepped
  | ColoursEvent
  | { readonly id: number; readonly value: unknown }
  | { readonly id: number; readonly fault: Fault }
  | { readonly event: "stats"; readonly stats: Stats }
  | { readonly event: "trouble"; readonly fault: Fault | null }
  | { readonly event: "failed"; readonly fault: Fault }
  | PageEvent
  | { readonly event: "drop"; readonly view: number; readonly ids: Uint32Array };

/** A route, or why there is none: a code of `ROUTE_CODE`, and three numbers for each place. */
export interface Routed {
  readonly code: number;
  readonly points: Float64Array;
}

/** Contents of a recording. */
export interface Recorded {
  readonly steps: Float64Array;
  readonly path: Float64Array;
}
