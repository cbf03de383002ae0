/** Archives as seen by the page. */

import { absolute } from "./address.js";
import { across, callable, copied, count, number, numbers, object, optional, place, refused, shown } from "./check.js";
import { makeCrowd } from "./crowd.js";
import { aborted, asError, fromFault } from "./fault.js";
import { Link, type WorkerLike } from "./link.js";
import type { BatchKind, FromWorker } from "./protocol.js";
import { toSlide, toSliding } from "./slide.js";
import {
  type Archive,
  type ArchiveEvents,
  type ArchiveInfo,
  type ArchiveReference,
  type BatchOptions,
  type Bounds,
  type Crowd,
  type CrowdOptions,
  type FarHits,
  type OpenOptions,
  type PlacedShape,
  type RayHits,
  type Slide,
  type SliceMap,
  type SlideOptions,
  type SlicewalkError,
  type Stats,
  type Vec3,
  type View,
  type ViewOptions,
  type Walker,
  type WalkerOptions,
} from "./types.js";
import { ViewHandle } from "./view.js";
import { makeWalker } from "./walker.js";

const NO_STATS: Stats = {
  pages: { resident: 0, bytes: 0 },
  usedBytes: 0,
  peakBytes: 0,
  budgetBytes: 0,
  loaded: 0,
  evicted: 0,
  missing: 0,
  unbuilt: 0,
  requests: 0,
  bytesLoaded: 0,
  pending: 0,
  colours: { missing: 0, requests: 0, bytes: 0 },
};

export function toRayHits(answers: Float64Array): RayHits {
  const count = answers.length / 5;
  const hits = { distances: new Float64Array(count), normals: new Float64Array(3 * count), obstacles: new Uint8Array(count) };
  for (let ray = 0; ray < count; ray++) {
    hits.distances[ray] = answers[5 * ray] as number;
    hits.normals.set(answers.subarray(5 * ray + 1, 5 * ray + 4), 3 * ray);
    hits.obstacles[ray] = answers[5 * ray + 4] as number;
  }
  return hits;
}

export class OpenArchive implements Archive {
  info!: ArchiveInfo;
  stats: Stats = NO_STATS;
  protected readonly link: Link;
  private readonly views = new Map<number, ViewHandle>();
  private readonly listeners: { [E in keyof ArchiveEvents]: Set<ArchiveEvents[E]> } = {
    stats: new Set(),
    trouble: new Set(),
    failed: new Set(),
  };
  private referenced: Promise<ArchiveReference> | undefined;

  constructor(worker: WorkerLike) {
    this.link = new Link(worker, (event) => this.happened(event));
  }

  async open(source: string | URL | Blob, options: OpenOptions): Promise<void> {
    const { wasm } = options;
    try {
      const info = await this.link.call<string>(
        {
          call: "open",
          source: source instanceof Blob ? source : absolute(source),
          wasm: typeof wasm === "string" || wasm instanceof URL ? absolute(wasm) : wasm,
          budgetBytes: number(options.budgetBytes ?? 64 << 20, "budgetBytes"),
          requests: count(options.requests ?? 6, "requests"),
          credentials: options.credentials,
        },
        options.signal,
      );
      const name = source instanceof Blob ? ((source as Partial<File>).name ?? "a file") : absolute(source);
      this.info = { name, ...JSON.parse(info) };
    } catch (thrown) {
      this.link.end(aborted());
      throw asError(thrown);
    }
  }

  get error(): SlicewalkError | null {
    return this.link.error;
  }

  on<E extends keyof ArchiveEvents>(event: E, listener: ArchiveEvents[E]): () => void {
    if (!Object.hasOwn(this.listeners, event)) {
      throw refused(`events are ${Object.keys(this.listeners).join(", ")}, found ${shown(event)}`);
    }
    callable(listener, "a listener");
    this.listeners[event].add(listener);
    return () => {
      this.listeners[event].delete(listener);
    };
  }

  reference(): Promise<ArchiveReference> {
    const reading = this.referenced ?? this.link.call<ArchiveReference>({ call: "reference" });
    this.referenced = reading;
    // After a failure the next call tries again.
    reading.catch(() => {
      this.referenced = undefined;
    });
    return reading;
  }

  async file(options?: { signal?: AbortSignal }): Promise<Blob> {
    return this.link.call<Blob>({ call: "file" }, optional(options).signal);
  }

  overlaps(boxes: Float64Array, options?: BatchOptions): Promise<Uint8Array> {
    return this.batch<Uint8Array>("overlaps", boxes, options);
  }

  overlapsSpheres(spheres: Float64Array, options?: BatchOptions): Promise<Uint8Array> {
    return this.batch<Uint8Array>("spheres", spheres, options);
  }

  overlapsCylinders(cylinders: Float64Array, options?: BatchOptions): Promise<Uint8Array> {
    return this.batch<Uint8Array>("cylinders", cylinders, options);
  }

  sweep(sweeps: Float64Array, options?: BatchOptions): Promise<Float64Array> {
    return this.batch("sweep", sweeps, options);
  }

  async cast(rays: Float64Array, options?: BatchOptions): Promise<Float64Array> {
    return (await this.castHits(rays, options)).distances;
  }

  async castHits(rays: Float64Array, options?: BatchOptions): Promise<RayHits> {
    return toRayHits(await this.batch<Float64Array>("cast", rays, options));
  }

  async castFar(rays: Float64Array, options?: { signal?: AbortSignal }): Promise<FarHits> {
    const answers = await this.batch<Float64Array>("far", rays, options);
    const count = answers.length / 2;
    return {
      distances: Float64Array.from({ length: count }, (_, ray) => answers[2 * ray] as number),
      coarse: Uint8Array.from({ length: count }, (_, ray) => answers[2 * ray + 1] as number),
    };
  }

  floor(boxes: Float64Array, options?: BatchOptions): Promise<Float64Array> {
    return this.batch("floor", boxes, options);
  }

  async moveAndSlide(shape: PlacedShape, motion: Vec3, options?: SlideOptions): Promise<Slide> {
    const { load = false, signal } = optional(options);
    const sliding = toSliding(shape, motion, options);
    const transfer = [sliding.shape.buffer, sliding.motion.buffer] as ArrayBuffer[];
    return toSlide(await this.link.call<Float64Array>({ call: "slide", load, ...sliding }, signal, transfer));
  }

  private async batch<T = Float64Array>(kind: BatchKind, given: Float64Array, options?: BatchOptions): Promise<T> {
    const { load = false, signal } = optional(options);
    const rows = copied(given);
    return this.link.call<T>({ call: "batch", kind, rows, load }, signal, [rows.buffer]);
  }

  async load(box: Bounds, options?: { signal?: AbortSignal }): Promise<void> {
    const { signal } = optional(options);
    const { min, max } = object(box, "a box");
    const corners = Float64Array.of(...place(min, "a corner of a box"), ...place(max, "a corner of a box"));
    return this.link.call<void>({ call: "load", box: corners }, signal);
  }

  async map(
    area: { min: readonly [number, number]; max: readonly [number, number] },
    heights: readonly [number, number],
    cells = 512,
  ): Promise<SliceMap> {
    const given = object(area, "an area");
    const [min, max] = [across(given.min, "a corner of an area"), across(given.max, "a corner of an area")];
    const bytes = await this.link.call<Uint8Array>({
      call: "map",
      area: Float64Array.of(...min, ...max, ...numbers(heights, 2, "the range of heights")),
      cells: count(cells, "cells"),
    });
    const head = new DataView(bytes.buffer, bytes.byteOffset, 24);
    const [width, height, cell] = [0, 8, 16].map((at) => head.getFloat64(at, true)) as [number, number, number];
    return { width, height, cell, cells: bytes.subarray(24), min };
  }

  pageBoxes(): Promise<Float64Array> {
    return this.link.call<Float64Array>({ call: "boxes" });
  }

  walker(options: WalkerOptions): Promise<Walker> {
    return makeWalker(this.link, options);
  }

  crowd(options: CrowdOptions): Promise<Crowd> {
    return makeCrowd(this.link, options);
  }

  view(options: ViewOptions): View {
    return new ViewHandle(this.link, options, this.info.pixelSize, this.views);
  }

  close(): void {
    this.link.end(aborted());
  }

  private happened(event: Extract<FromWorker, { event: string }>): void {
    switch (event.event) {
      case "stats":
        this.stats = event.stats;
        this.tell("stats", this.stats);
        break;
      case "trouble":
        this.tell("trouble", event.fault && fromFault(event.fault));
        break;
      case "failed":
        this.tell("failed", fromFault(event.fault));
        break;
      case "page":
        this.views.get(event.view)?.page(event);
        break;
      case "colours":
        this.views.get(event.paint.view)?.colours(event);
        break;
      case "drop":
        this.views.get(event.view)?.drop(event.ids);
        break;
    }
  }

  private tell<E extends keyof ArchiveEvents>(event: E, value: Parameters<ArchiveEvents[E]>[0]): void {
    for (const listener of this.listeners[event]) {
      (listener as (value: unknown) => void)(value);
    }
  }
}
