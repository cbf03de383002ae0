// Reads a COPC point cloud by ranges, in the detail that the eye can resolve, and posts points relative to an origin. Runs in its
// own worker, because decoding takes longer than a frame.

import { Copc, Hierarchy } from "copc";
import { create, type LazPerf } from "laz-perf/lib/worker";
import decoder from "laz-perf/lib/worker/laz-perf.wasm?url";
import { choose, type NodeName, type Octree } from "./detail";

/** Colour of points without any. */
const GREY = 200;

type Vec3 = readonly [number, number, number];

/** What to read, posted once. */
export interface CloudRequest {
  readonly url: string;
  readonly origin: Vec3;
  /** Metres per unit of the cloud. */
  readonly unit: number;
  /** Most points at a time. */
  readonly most: number;
}

/** From where the cloud is seen (m), posted whenever it changes. */
export interface CloudLook {
  readonly eye: Vec3;
  /** Distance beyond which no points are needed (m). */
  readonly far: number;
  /** Spacing over distance that looks closed. */
  readonly finest: number;
}

export interface CloudPart {
  readonly name: NodeName;
  readonly positions: Float32Array;
  readonly colours: Uint8Array;
}

/** A part that was read, parts that are not needed any more, or all that this look needs with the gap that it leaves. */
export type CloudAnswer =
  | { readonly part: CloudPart }
  | { readonly gone: NodeName }
  | { readonly done: number; readonly gap: number }
  | { readonly error: string };

const post = (answer: CloudAnswer, transfer: Transferable[] = []): void =>
  (self as unknown as Worker).postMessage(answer, transfer);

class Reader implements Octree {
  readonly #loaded = new Map<NodeName, number>();
  readonly #nodes: Hierarchy.Node.Map = {};
  readonly #pages: Hierarchy.Page.Map = {};
  /** Value of colours or intensities that is drawn as 255, by the points read first; infinite if they have neither. */
  #brightest = 0;

  private constructor(
    readonly request: CloudRequest,
    readonly get: (begin: number, end: number) => Promise<Uint8Array>,
    readonly copc: Copc,
    readonly lazPerf: LazPerf,
  ) {}

  static async open(request: CloudRequest): Promise<Reader> {
    const get = async (begin: number, end: number): Promise<Uint8Array> => {
      const answer = await fetch(request.url, { headers: { Range: `bytes=${begin}-${end - 1}` } });
      if (answer.status !== 206) throw new Error(`the cloud's host answers ${answer.status} (expected 206)`);
      return new Uint8Array(await answer.arrayBuffer());
    };
    const reader = new Reader(request, get, await Copc.create(get), await create({ locateFile: () => decoder }));
    await reader.#unfold(reader.copc.info.rootHierarchyPage);
    return reader;
  }

  async #unfold(page: Hierarchy.Page): Promise<void> {
    const { nodes, pages } = await Copc.loadHierarchyPage(this.get, page);
    Object.assign(this.#nodes, nodes);
    Object.assign(this.#pages, pages);
  }

  get cube(): readonly number[] {
    return this.copc.info.cube;
  }

  get spacing(): number {
    return this.copc.info.spacing;
  }

  async points(name: NodeName): Promise<number | null> {
    const page = this.#pages[name];
    if (page !== undefined) {
      delete this.#pages[name];
      await this.#unfold(page);
    }
    return this.#nodes[name]?.pointCount ?? null;
  }

  /** Reads what a look needs, coarse nodes first, and forgets the rest; ends early when `outdated` says so. */
  async follow({ eye, far, finest }: CloudLook, outdated: () => boolean): Promise<void> {
    const { unit, most } = this.request;
    const at = eye.map((value) => value / unit);
    const { names, gap } = await choose(this, at, most, far / unit, finest);
    const kept = new Set(names);
    for (const name of [...this.#loaded.keys()].filter((name) => !kept.has(name))) {
      this.#loaded.delete(name);
      post({ gone: name });
    }
    for (const name of names) {
      if (outdated()) return;
      if (!this.#loaded.has(name)) await this.#read(name);
    }
    post({ done: [...this.#loaded.values()].reduce((sum, count) => sum + count, 0), gap });
  }

  async #read(name: NodeName): Promise<void> {
    const node = this.#nodes[name];
    if (node === undefined) return;
    const { origin, unit } = this.request;
    const view = await Copc.loadPointDataView(this.get, this.copc, node, { lazPerf: this.lazPerf });
    const count = view.pointCount;
    const coordinates = ["X", "Y", "Z"].map((dimension) => view.getter(dimension));
    const channels = ("Red" in view.dimensions ? ["Red", "Green", "Blue"] : ["Intensity"]).map((dimension) =>
      view.getter(dimension),
    );
    const positions = new Float32Array(3 * count);
    const colours = new Uint8ClampedArray(3 * count);
    if (this.#brightest === 0) {
      for (let n = 0; n < count; n++) channels.forEach((value) => (this.#brightest = Math.max(this.#brightest, value(n))));
      if (this.#brightest === 0) this.#brightest = Infinity;
      // Colours have 16 bits, but some writers fill only 8.
      else if (channels.length === 3) this.#brightest = this.#brightest > 255 ? 65535 : 255;
    }
    const scale = 255 / this.#brightest;
    const least = this.#brightest === Infinity ? GREY : 0;
    for (let n = 0; n < count; n++) {
      for (let axis = 0; axis < 3; axis++) {
        positions[3 * n + axis] = (coordinates[axis]?.(n) ?? 0) * unit - (origin[axis] ?? 0);
        colours[3 * n + axis] = least + ((channels[axis] ?? channels[0])?.(n) ?? 0) * scale;
      }
    }
    this.#loaded.set(name, count);
    const part = { name, positions, colours: new Uint8Array(colours.buffer) };
    post({ part }, [positions.buffer, colours.buffer]);
  }
}

let reader: Promise<Reader> | null = null;
let latest: CloudLook | null = null;
let following = false;

/** Follows the latest look until there is no other. */
async function follow(): Promise<void> {
  if (following || reader === null) return;
  following = true;
  const cloud = await reader;
  for (let look: CloudLook | null = null; look !== latest && latest !== null;) {
    look = latest;
    await cloud.follow(look, () => look !== latest);
  }
  following = false;
}

self.addEventListener("message", ({ data }: MessageEvent<CloudRequest | CloudLook>) => {
  if ("url" in data) reader = Reader.open(data);
  else latest = data;
  follow().catch((error: unknown) => post({ error: error instanceof Error ? error.message : String(error) }));
});
