// A plain static host on loopback: files of folders, single ranges, an ETag, and nothing else. It notes each request, and can
// delay, throttle, vanish and come back on the same port.

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

export class StaticServer {
  /** Folder and names that stand for other files: `{ "/house.slices": "/tmp/a.slices" }`. */
  constructor(folder, files = {}) {
    Object.assign(this, { folder, files, requests: [], delayMs: 0, bytesPerSecond: Infinity, port: 0 });
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
    this.server.closeAllConnections();
    await new Promise((resolve) => this.server.close(resolve));
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
    const note = { path, range: request.headers.range ?? null, bytes: 0, status: 404 };
    this.requests.push(note);
    if (this.delayMs > 0) await new Promise((resolve) => setTimeout(resolve, this.delayMs));
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
      const bytes = Buffer.alloc(last - first + 1);
      await file.read(bytes, 0, bytes.length, first);
      note.bytes = bytes.length;
      if (this.bytesPerSecond < Infinity)
        await new Promise((resolve) => setTimeout(resolve, (1000 * bytes.length) / this.bytesPerSecond));
      response
        .writeHead(note.status, { ...headers, "Content-Length": bytes.length })
        .end(request.method === "HEAD" ? undefined : bytes);
    } finally {
      await file.close();
    }
  }
}
