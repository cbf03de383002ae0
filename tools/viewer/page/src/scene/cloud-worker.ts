// Reads a COPC point cloud by ranges, coarse nodes first, and posts its points relative to an origin. Runs in its own
// worker, because decoding takes longer than a frame.

import { Copc, type Hierarchy } from "copc";
import { create } from "laz-perf/lib/worker";
import decoder from "laz-perf/lib/worker/laz-perf.wasm?url";

export interface CloudRequest {
  readonly url: string;
  readonly origin: readonly [number, number, number];
  /** Metres per unit of the cloud. */
  readonly unit: number;
  readonly most: number;
}

export interface CloudPart {
  readonly positions: Float32Array;
  readonly colours: Uint8Array;
}

export type CloudAnswer = { readonly part: CloudPart } | { readonly done: number } | { readonly error: string };

const post = (answer: CloudAnswer, transfer: Transferable[] = []): void =>
  (self as unknown as Worker).postMessage(answer, transfer);

/** Depth of a node, the first number of its name. */
const depth = ([name]: [string, unknown]): number => Number(name.split("-")[0]);

async function read({ url, origin, unit, most }: CloudRequest): Promise<number> {
  const get = async (begin: number, end: number): Promise<Uint8Array> => {
    const answer = await fetch(url, { headers: { Range: `bytes=${begin}-${end - 1}` } });
    if (answer.status !== 206) throw new Error(`the cloud's host answers ${answer.status} (expected 206)`);
    return new Uint8Array(await answer.arrayBuffer());
  };
  const lazPerf = await create({ locateFile: () => decoder });
  const copc = await Copc.create(get);
  const { nodes } = await Copc.loadHierarchyPage(get, copc.info.rootHierarchyPage);
  const all = Object.entries(nodes).filter((entry): entry is [string, Hierarchy.Node] => entry[1] !== undefined);
  let count = 0;
  for (const [, node] of all.sort((a, b) => depth(a) - depth(b))) {
    if (count + node.pointCount > most) break;
    if (node.pointCount === 0) continue;
    const view = await Copc.loadPointDataView(get, copc, node, { lazPerf });
    const coordinates = ["X", "Y", "Z"].map((name) => view.getter(name));
    const coloured = "Red" in view.dimensions;
    const channels = coloured ? ["Red", "Green", "Blue"].map((name) => view.getter(name)) : [];
    const positions = new Float32Array(3 * view.pointCount);
    const colours = new Uint8Array(3 * view.pointCount).fill(200);
    // Colours have 16 bits, but some writers fill only 8.
    let bright = 0;
    for (let n = 0; n < view.pointCount; n++) {
      coordinates.forEach((value, axis) => (positions[3 * n + axis] = value(n) * unit - (origin[axis] ?? 0)));
      channels.forEach((value) => (bright = Math.max(bright, value(n))));
    }
    const scale = bright > 255 ? 1 / 257 : 1;
    for (let n = 0; n < view.pointCount; n++) channels.forEach((value, axis) => (colours[3 * n + axis] = value(n) * scale));
    count += view.pointCount;
    post({ part: { positions, colours } }, [positions.buffer, colours.buffer]);
  }
  return count;
}

self.addEventListener("message", (event: MessageEvent<CloudRequest>) => {
  read(event.data).then(
    (done) => post({ done }),
    (error: unknown) => post({ error: error instanceof Error ? error.message : String(error) }),
  );
});
