// A plain static host on loopback: files of folders, single ranges, an ETag, and nothing else. It records each request,
// can disappear and return on the same port, and can hold back answers for good. All answers of archives share a link
// with a delay and a rate.

import { createServer } from "node:http";
import { open } from "node:fs/promises";
import { extname, join, normalize } from "node:path";

const TYPES = {
  ".html": "text/html; charset=utf-8",
  ".js": "text/javascript; charset=utf-8",
  ".css": "text/css; charset=utf-8",
  ".json": "application/json",
  ".wasm": "application/wasm",
  ".svg": "image/svg+xml",
  ".txt": "text/plain; charset=utf-8",
};

/** Bytes per piece in which answers share the link. */
const PIECE = 16 << 10;

const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

export class StaticServer {
  /** Folder, and names that map to other files: `{ "/house.slices": "/tmp/a.slices" }`. */
  constructor(folder, files = {}) {
    Object.assign(this, { folder, files, requests: [], delayMs: 0, bytesPerSecond: Infinity, free: 0, port: 0 });
    /** Returns whether the answer to a range never comes, by its first and last byte. */
    this.holds = () => false;
    /** What requests that come while it is set wait for before they are answered. */
    this.until = null;
  }

  async start() {
    this.server = createServer((request, response) => {
      this.#answer(request, response).catch(() => response.destroy());
    });
    await new Promise((resolve, reject) => {
      this.server.once("error", reject);
      this.server.listen(this.port, "127.0.0.1", resolve);
    });
    this.port = this.server.address().port;
    return this;
  }

  /** Ends all connections and refuses new ones. */
  async stop() {
    const closed = new Promise((resolve) => this.server.close(resolve));
    this.server.closeAllConnections();
    await closed;
  }

  get address() {
    return `http://127.0.0.1:${this.port}/`;
  }

  /** Requests of one file so far. */
  of(ending) {
    return this.requests.filter(({ path }) => path.endsWith(ending));
  }

  async #answer(request, response) {
    const path = decodeURIComponent(new URL(request.url, this.address).pathname);
    const name = this.files[path] ?? join(this.folder, normalize(path === "/" ? "/index.html" : path));
    const note = { path, range: request.headers.range ?? null, at: Date.now(), bytes: 0, status: 404 };
    this.requests.push(note);
    await this.until;
    if (this.delayMs > 0) await sleep(this.delayMs);
    const file = await open(name).catch(() => null);
    if (file === null) {
      response.writeHead(404, { "Content-Type": "text/plain" }).end("not found\n");
      return;
    }
    try {
      const { size, mtimeMs } = await file.stat();
      const headers = {
        "Content-Type": TYPES[extname(path === "/" ? ".html" : path)] ?? TYPES[extname(name)] ?? "application/octet-stream",
        "Accept-Ranges": "bytes",
        "Cache-Control": "no-cache",
        ETag: `"${size.toString(16)}-${Math.round(mtimeMs * 1000).toString(16)}"`,
      };
      const range = /^bytes=(\d+)-(\d*)$/.exec(note.range ?? "");
      const [first, last] = range
        ? [Number(range[1]), range[2] === "" ? size - 1 : Math.min(Number(range[2]), size - 1)]
        : [0, size - 1];
      if (range && first > last) {
        note.status = 416;
        response.writeHead(416, { "Content-Range": `bytes */${size}` }).end();
        return;
      }
      note.status = range ? 206 : 200;
      if (range) headers["Content-Range"] = `bytes ${first}-${last}/${size}`;
      if (range && this.holds(first, last)) {
        await new Promise((resolve) => response.once("close", resolve));
        note.status = 0;
        return;
      }
      const bytes = Buffer.alloc(last - first + 1);
      await file.read(bytes, 0, bytes.length, first);
      note.bytes = bytes.length;
      response.writeHead(note.status, { ...headers, "Content-Length": bytes.length });
      if (request.method === "HEAD") response.end();
      else await this.#send(response, bytes, range !== null);
    } finally {
      await file.close();
    }
  }

  /** Sends bytes at the rate of the link. */
  async #send(response, bytes, shared) {
    const piece = shared && this.bytesPerSecond < Infinity ? PIECE : bytes.length;
    for (let at = 0; at < bytes.length && !response.destroyed; at += piece) {
      const part = bytes.subarray(at, at + piece);
      if (piece < bytes.length) {
        const now = performance.now();
        this.free = Math.max(now, this.free) + (1000 * part.length) / this.bytesPerSecond;
        await sleep(this.free - now);
      }
      response.write(part);
    }
    response.end();
  }
}
