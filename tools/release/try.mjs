// Opens every archive of this folder with the installed package, from a server on loopback, and asks it for boxes.

import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { createServer } from "node:http";
import { HIT, openArchive, SlicewalkError } from "slicewalk";
// Node.js has no Web Worker, so the worker's side runs in place.
import { Host } from "./node_modules/slicewalk/dist/host.js";
import { browser } from "./node_modules/slicewalk/dist/http.js";
import init, { Engine } from "./node_modules/slicewalk/dist/wasm/engine.js";

const wasm = new WebAssembly.Module(readFileSync("node_modules/slicewalk/dist/wasm/engine_bg.wasm"));
const loaded = init({ module_or_path: wasm });
const engine = async () => {
  await loaded;
  return { open: (length, budget, requests) => new Engine(length, budget, requests), isFull: () => false };
};

class Local {
  constructor() {
    const later = (data, transfer, then) => {
      const moved = structuredClone(data, { transfer });
      setImmediate(() => then(moved));
    };
    this.host = new Host({ post: (data, transfer) => later(data, transfer, (m) => this.onmessage?.({ data: m })) }, engine, browser);
    this.postMessage = (data, transfer = []) => later(data, transfer, (m) => this.host.receive(m));
    this.terminate = () => this.host.close();
  }
}

const server = createServer((request, response) => {
  const bytes = readFileSync(`.${request.url}`);
  const range = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "");
  const [start, end] = range ? [Number(range[1]), Math.min(Number(range[2]) + 1, bytes.length)] : [0, bytes.length];
  const headers = { ETag: '"1"', "Content-Range": `bytes ${start}-${end - 1}/${bytes.length}` };
  response.writeHead(range ? 206 : 200, headers).end(bytes.subarray(start, end));
});
await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
let opened = 0;
for (const name of readdirSync(".").filter((name) => /^(?!damaged).*\.slices$/.test(name))) {
  try {
    const archive = await openArchive(`http://127.0.0.1:${server.address().port}/${name}`, { worker: () => new Local() });
    if (archive.info.bounds) {
      const { min, max } = archive.info.bounds;
      assert.deepEqual(Array.from(await archive.overlaps(Float64Array.of(...min, ...max), { load: true })), [HIT], name);
      opened++;
    }
    archive.close();
  } catch (error) {
    // Some samples need a newer version of the format.
    if (!(error instanceof SlicewalkError)) throw error;
  }
}
server.closeAllConnections();
server.close();
assert.ok(opened >= 3, `${opened} archives opened`);
console.log(`npm package: ${opened} archives opened`);
