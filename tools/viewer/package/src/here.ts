/** Archives in the calling thread, without a worker: their queries also answer at once. */

import { OpenArchive, toRayHits } from "./archive.js";
import { optional, rows } from "./check.js";
import { CrowdHandle } from "./crowd.js";
import { loadEngine } from "./engine.js";
import { aborted } from "./fault.js";
import { Host } from "./host.js";
import type { Link, WorkerLike } from "./link.js";
import type { FromWorker, ToWorker } from "./protocol.js";
import { toSlide, toSliding } from "./slide.js";
import {
  type Archive,
  type Crowd,
  type CrowdState,
  type OpenOptions,
  type PlacedShape,
  type RayHits,
  type Slide,
  SlicewalkError,
  type SlideOptions,
  type Vec3,
  type Walker,
  type WalkerInput,
  type WalkerState,
} from "./types.js";
import { WalkerHandle } from "./walker.js";

/** Options of {@link openArchiveHere}. */
export type HereOptions = Omit<OpenOptions, "worker">;

/** An archive whose host runs in the calling thread. */
export interface ArchiveHere extends Archive {
  readonly now: Now;
}

/**
 * Queries that answer at once, from the pages in memory. They load nothing, and what is not loaded is an answer of its
 * own: load pages with {@link Archive.load}, or let a walker or a view do so. Rows and answers are those of the methods
 * of {@link Archive} with the same names; errors are thrown.
 */
export interface Now {
  overlaps(boxes: Float64Array): Uint8Array;
  overlapsSpheres(spheres: Float64Array): Uint8Array;
  overlapsCylinders(cylinders: Float64Array): Uint8Array;
  sweep(sweeps: Float64Array): Float64Array;
  cast(rays: Float64Array): Float64Array;
  castHits(rays: Float64Array): RayHits;
  floor(boxes: Float64Array): Float64Array;
  moveAndSlide(shape: PlacedShape, motion: Vec3, options?: Pick<SlideOptions, "iterations">): Slide;
  /** Like {@link Walker.step}, of a walker of this archive. */
  step(walker: Walker, seconds: number, input?: WalkerInput): WalkerState;
  /** Like {@link Crowd.step}, of a crowd of this archive. */
  stepCrowd(crowd: Crowd, seconds: number, wishes: Float64Array): CrowdState;
}

/**
 * Opens an archive in the calling thread: for a worker of your own, Node.js, and pages that need answers within a frame.
 * Pages are read and decoded between your own tasks, a few milliseconds at a time; a program that never returns to the
 * event loop loads nothing. Close the archive: until then its memory is held, and Node.js does not exit.
 *
 * In Node.js a file is a `file:` URL, or a `Blob` from `fs.openAsBlob`.
 */
export async function openArchiveHere(source: string | URL | Blob, options?: HereOptions): Promise<ArchiveHere> {
  const given = optional(options);
  if (given.signal?.aborted) {
    throw aborted();
  }
  const bytes = await readable(source);
  const archive = new HereArchive(new InPlace());
  await archive.open(bytes, given);
  return archive;
}

/** The part of Node.js that is used where there is one. */
interface FileSystem {
  openAsBlob?(path: URL): Promise<Blob>;
  readFileSync(path: URL): Uint8Array<ArrayBuffer>;
}

/** Loads `node:fs` in Node.js only; bundlers must not look for it. */
async function fileSystem(): Promise<FileSystem | undefined> {
  const { process } = globalThis as { process?: { versions?: { node?: string } } };
  const name = "node:fs";
  return process?.versions?.node ? import(/* @vite-ignore */ /* webpackIgnore: true */ name) : undefined;
}

/** Node.js does not fetch files. */
async function readable(source: string | URL | Blob): Promise<string | URL | Blob> {
  if (source instanceof Blob || !String(source).startsWith("file:")) {
    return source;
  }
  const files = await fileSystem();
  if (!files?.openAsBlob) {
    return source;
  }
  try {
    return await files.openAsBlob(new URL(source));
  } catch (cause) {
    throw new SlicewalkError("network", `${source} cannot be read`, { cause });
  }
}

async function engineHere(wasm: string | WebAssembly.Module | undefined) {
  const url = wasm ?? new URL("./wasm/engine_bg.wasm", import.meta.url).href;
  if (typeof url === "string" && url.startsWith("file:")) {
    const files = await fileSystem();
    return loadEngine(files ? files.readFileSync(new URL(url)) : url);
  }
  return loadEngine(wasm);
}

/** Stands in for a worker: a host in this thread. */
class InPlace implements WorkerLike {
  onmessage: WorkerLike["onmessage"] = null;
  onerror: WorkerLike["onerror"] = null;
  readonly host = new Host({ post: (message) => this.deliver(message) }, engineHere);
  private over = false;

  postMessage(message: ToWorker): void {
    this.host.receive(message);
  }

  terminate(): void {
    this.over = true;
    this.host.close();
  }

  private deliver(message: FromWorker): void {
    if ("event" in message) {
      // Later, because listeners of the caller may fail or call the archive.
      queueMicrotask(() => this.hand(message));
    } else {
      this.hand(message);
    }
  }

  private hand(message: FromWorker): void {
    if (!this.over) {
      this.onmessage?.({ data: message } as MessageEvent<FromWorker>);
    }
  }
}

class HereArchive extends OpenArchive implements ArchiveHere {
  readonly now: Now;

  constructor(place: InPlace) {
    super(place);
    this.now = new Immediate(this.link, place.host);
  }
}

class Immediate implements Now {
  constructor(
    private readonly link: Link,
    private readonly host: Host,
  ) {}

  overlaps(boxes: Float64Array): Uint8Array {
    return this.host.batchNow("overlaps", rows(boxes)) as Uint8Array;
  }

  overlapsSpheres(spheres: Float64Array): Uint8Array {
    return this.host.batchNow("spheres", rows(spheres)) as Uint8Array;
  }

  overlapsCylinders(cylinders: Float64Array): Uint8Array {
    return this.host.batchNow("cylinders", rows(cylinders)) as Uint8Array;
  }

  sweep(sweeps: Float64Array): Float64Array {
    return this.host.batchNow("sweep", rows(sweeps)) as Float64Array;
  }

  cast(rays: Float64Array): Float64Array {
    return this.castHits(rays).distances;
  }

  castHits(rays: Float64Array): RayHits {
    return toRayHits(this.host.batchNow("cast", rows(rays)) as Float64Array);
  }

  floor(boxes: Float64Array): Float64Array {
    return this.host.batchNow("floor", rows(boxes)) as Float64Array;
  }

  moveAndSlide(shape: PlacedShape, motion: Vec3, options?: Pick<SlideOptions, "iterations">): Slide {
    return toSlide(this.host.slideNow(toSliding(shape, motion, options)));
  }

  step(walker: Walker, seconds: number, input?: WalkerInput): WalkerState {
    if (!(walker instanceof WalkerHandle)) {
      throw new SlicewalkError("invalid", "this is no walker of the archive");
    }
    return walker.stepBy(this.link, this.host, seconds, input);
  }
  stepCrowd(crowd: Crowd, seconds: number, wishes: Float64Array): CrowdState {
    if (!(crowd instanceof CrowdHandle)) {
      throw new SlicewalkError("invalid", "this is no crowd of the archive");
    }
    return crowd.stepBy(this.link, this.host, seconds, wishes);
  }
}
