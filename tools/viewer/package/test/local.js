// An in-process worker and a host of files, for tests.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { loadEngine } from "../dist/engine.js";
import { Host } from "../dist/host.js";
import { browser } from "../dist/http.js";

/** Output folder of `record`. */
export const folder =
  process.env.SLICEWALK_ENGINE_CHECK ?? new URL("../../../../target/engine-check", import.meta.url).pathname;

export const read = (name) => {
  const bytes = readFileSync(`${folder}/${name}`);
  return new Uint8Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
};
export const numbers = (name) => new Float64Array(read(name).buffer);

/** Rows whose buffer was transferred elsewhere. */
export function gone() {
  const rows = new Float64Array(6);
  structuredClone(rows, { transfer: [rows.buffer] });
  return rows;
}

export async function until(what, seconds = 10) {
  for (let n = 0; !what(); n++) {
    assert.ok(n < seconds * 200, `never: ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 5));
  }
}

const bytes = readFileSync(new URL("../dist/wasm/engine_bg.wasm", import.meta.url));
const compiled = new WebAssembly.Module(bytes);

export const engineModule = () => loadEngine(compiled);

/** Replaces a `Worker`; messages are cloned and transferred as between threads. */
export class LocalWorker {
  constructor(fetch) {
    this.host = new Host(
      { post: (data, transfer) => this.#later(data, transfer, (m) => this.onmessage?.({ data: m })) },
      engineModule,
      {
        ...browser,
        fetch,
      },
    );
  }

  #later(data, transfer, then) {
    const moved = structuredClone(data, { transfer });
    setImmediate(() => {
      if (!this.over) then(moved);
    });
  }

  postMessage(data, transfer = []) {
    this.#later(data, transfer, (m) => this.host.receive(m));
  }

  terminate() {
    this.over = true;
    this.host.close();
  }
}

/** A host of one file, with its current content and the requests it received. */
export class FileHost {
  asked = [];
  down = false;
  delay = 1;
  etag = '"1"';

  constructor(file) {
    this.file = file;
  }

  fetch = async (_url, init) => {
    const [, first, given] = /^bytes=(\d+)-(\d*)$/.exec(init.headers.Range);
    const last = given || this.file.length - 1;
    this.asked.push([Number(first), Number(last) + 1]);
    await new Promise((resolve) => setTimeout(resolve, this.delay));
    if (init.signal.aborted) throw new DOMException("", "AbortError");
    if (this.down) throw new TypeError("fetch failed");
    const { length } = this.file;
    const end = Math.min(Number(last) + 1, length);
    const headers = { ETag: this.etag, "Content-Range": `bytes ${first}-${end - 1}/${length}` };
    return new Response(this.file.slice(Number(first), end), { status: 206, headers });
  };

  worker = () => new LocalWorker(this.fetch);
}
