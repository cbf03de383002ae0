/** Messages between page and worker. */

import type { Fault } from "./fault.js";

/** Opens an archive: the first message to a worker. */
export interface Open {
  readonly call: "open";
  readonly source: string | Blob;
  readonly wasm: string | WebAssembly.Module | undefined;
  readonly budgetBytes: number;
  readonly requests: number;
  readonly credentials: RequestCredentials | undefined;
}

export type BatchKind = "overlaps" | "sweep" | "cast" | "far" | "floor";

export type SceneSettings = readonly [radius: number, triangles: number, detail: number, overview: boolean];

/** Calls with an answer. */
export type Call =
  | Open
  | { readonly call: "reference" }
  | { readonly call: "batch"; readonly kind: BatchKind; readonly rows: Float64Array; readonly load: boolean }
  | { readonly call: "load"; readonly box: Float64Array }
  | { readonly call: "map"; readonly area: Float64Array; readonly cells: number }
  | { readonly call: "walker"; readonly settings: Float64Array; readonly at: Float64Array }
  | { readonly call: "place"; readonly walker: number; readonly at: Float64Array }
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
 * A step. Its numbers are in a plain array, because steps come every frame, and browsers take longer for objects and
 * typed arrays. To the worker: id of the call, walker, seconds, and the five numbers of the input. The answer: id of
 * the call, and the twelve numbers of a state. A fault comes as for any call.
 */
export type Step = number[];

export type ToWorker = (Call & { readonly id: number }) | Note | Step;

/** A built page; `numbers` are those of the engine's `build`. */
export interface PageMessage {
  readonly event: "page";
  readonly view: number;
  readonly numbers: Float64Array;
  readonly positions: Uint16Array;
  readonly normals: Int8Array;
  readonly attributes: Uint8Array;
}

/** Colours of a built page; `numbers` are view, page and cells along an edge. */
export interface ColoursMessage {
  readonly event: "colours";
  readonly numbers: Float64Array;
  readonly cells: Uint32Array;
  readonly colours: Uint8Array;
}

export type FromWorker =
  | Step
  | ColoursMessage
  | { readonly id: number; readonly value: unknown }
  | { readonly id: number; readonly fault: Fault }
  | { readonly event: "stats"; readonly numbers: Float64Array }
  | { readonly event: "trouble"; readonly fault: Fault | null }
  | { readonly event: "failed"; readonly fault: Fault }
  | PageMessage
  | { readonly event: "drop"; readonly view: number; readonly ids: Uint32Array };

/** Contents of a recording. */
export interface Recorded {
  readonly steps: Float64Array;
  readonly path: Float64Array;
}
