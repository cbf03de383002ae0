// The packed package in two empty projects: with a bundler, and as a plain module script. Both run in a browser if
// there is one.

import assert from "node:assert/strict";
import { execFileSync, spawn, spawnSync } from "node:child_process";
import { mkdirSync, mkdtempSync, readdirSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { extname, join, normalize } from "node:path";
import { after, before, test } from "node:test";
import { folder } from "./local.js";

const here = new URL("..", import.meta.url).pathname;
const browser = ["chromium", "chromium-browser", "google-chrome"].find((name) => spawnSync("which", [name]).status === 0);
let work;
let packed;

before(() => {
  work = mkdtempSync(join(tmpdir(), "slicewalk-"));
  const [{ filename }] = JSON.parse(
    execFileSync("npm", ["pack", "--json", "--pack-destination", work], { cwd: here, stdio: ["ignore", "pipe", "ignore"] }),
  );
  packed = join(work, filename);
});
// Processes of a browser that has ended may still write.
after(() => rmSync(work, { recursive: true, force: true, maxRetries: 20, retryDelay: 100 }));

/** Script of a page: opens, queries, walks, draws, and reports the results. */
const script = (from, here) => `
  import { openArchive } from ${JSON.stringify(from)};
  import { openArchiveHere } from ${JSON.stringify(here)};
  const answer = { error: null };
  try {
    const archive = await openArchive("/scene.slices");
    answer.boxes = Array.from(await archive.overlaps(Float64Array.of(-1, -1, -0.5, 1, 1, 0.5, 50, 50, 50, 51, 51, 51), { load: true }));
    const walker = await archive.walker({ at: [-2, 2, 0.2] });
    await archive.load({ min: [-4, 0, -1], max: [0, 4, 3] });
    for (let n = 0; n < 120; n++) await walker.step(1 / 60, {});
    answer.ground = walker.state.ground;
    answer.triangles = await new Promise((resolve) => {
      archive.view({ radius: 3, onPage: (page) => resolve(page.indices.length / 3), onDrop: () => undefined }).look([0, 0, 1]);
    });
    archive.close();
    const here = await openArchiveHere("/scene.slices");
    await here.load({ min: [-1, -1, -1], max: [1, 1, 1] });
    answer.here = Array.from(here.now.overlaps(Float64Array.of(-1, -1, -0.5, 1, 1, 0.5)));
    here.close();
  } catch (error) {
    answer.error = String(error?.stack ?? error);
  }
  await fetch("/answer", { method: "POST", body: JSON.stringify(answer) });
`;

const TYPES = { ".html": "text/html", ".js": "text/javascript", ".wasm": "application/wasm" };

/** Serves a folder on loopback, opens its page and returns its report. */
async function inBrowser(root) {
  let told;
  const answer = new Promise((resolve) => {
    told = resolve;
  });
  const server = createServer((request, response) => {
    if (request.method === "POST") {
      let body = "";
      request.on("data", (chunk) => {
        body += chunk;
      });
      request.on("end", () => {
        response.end();
        told(JSON.parse(body));
      });
      return;
    }
    const path = normalize(new URL(request.url, "http://host").pathname);
    const file = path === "/scene.slices" ? join(folder, "scene.slices") : join(root, path === "/" ? "index.html" : path);
    let bytes;
    try {
      bytes = readFileSync(file);
    } catch {
      response.writeHead(404).end();
      return;
    }
    const headers = { "Content-Type": TYPES[extname(file)] ?? "application/octet-stream", ETag: '"1"' };
    const range = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "");
    if (range) {
      const [start, end] = [Number(range[1]), Math.min(Number(range[2]) + 1, bytes.length)];
      headers["Content-Range"] = `bytes ${start}-${end - 1}/${bytes.length}`;
      response.writeHead(206, headers).end(bytes.subarray(start, end));
    } else {
      response.writeHead(200, headers).end(bytes);
    }
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  const profile = mkdtempSync(join(work, "profile-"));
  const options = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    `--user-data-dir=${profile}`,
    "--remote-debugging-port=0",
  ];
  const running = spawn(browser, [...options, `http://127.0.0.1:${server.address().port}/`], { stdio: "ignore" });
  const patience = AbortSignal.timeout(100_000);
  try {
    return await Promise.race([
      answer,
      new Promise((_, reject) => patience.addEventListener("abort", () => reject(new Error("the page never answers")))),
    ]);
  } finally {
    const gone = new Promise((resolve) => running.on("exit", resolve));
    running.kill();
    const late = setTimeout(() => running.kill("SIGKILL"), 5_000);
    await gone;
    clearTimeout(late);
    server.closeAllConnections();
    server.close();
  }
}

function project(name, files) {
  const root = join(work, name);
  mkdirSync(root);
  for (const [file, text] of Object.entries(files)) writeFileSync(join(root, file), text);
  execFileSync("npm", ["install", "--offline", "--no-audit", "--no-fund", packed], { cwd: root, stdio: "ignore" });
  return root;
}

function sound(answer) {
  assert.equal(answer.error, null);
  assert.deepEqual([answer.boxes, answer.ground, answer.here], [[1, 0], "walking", [1]]);
  assert.ok(answer.triangles > 0);
}

test("the package holds what it needs and no more", () => {
  const [{ files, size }] = JSON.parse(
    execFileSync("npm", ["pack", "--json", "--dry-run"], { cwd: here, stdio: ["ignore", "pipe", "ignore"] }),
  );
  const names = files.map((file) => file.path);
  for (const name of [
    "README.md",
    "LICENSE-MIT",
    "dist/index.js",
    "dist/index.d.ts",
    "dist/types.d.ts",
    "dist/worker.js",
    "dist/here.js",
    "dist/wasm/engine_bg.wasm",
    "dist/wasm/convert.wasm",
  ]) {
    assert.ok(names.includes(name), `${name} is missing of ${names}`);
  }
  assert.ok(!names.some((name) => /^(src|test|node_modules)\//.test(name)), names.join());
  // Four fifths are the conversion, which a page fetches only to convert.
  assert.ok(size < 1_750_000, `${size} bytes`);
});

test("as a plain module script", { timeout: 180_000 }, async (t) => {
  const root = project("plain", {
    "package.json": "{}",
    "index.html": `<!doctype html><script type="module">${script("./node_modules/slicewalk/dist/index.js", "./node_modules/slicewalk/dist/here.js")}</script>`,
  });
  if (!browser) {
    t.skip("no Chromium here");
    return;
  }
  sound(await inBrowser(root));
});

test("with a bundler", { timeout: 180_000 }, async (t) => {
  const root = project("bundled", {
    "package.json": "{}",
    "index.html": '<!doctype html><script type="module" src="/main.js"></script>',
    "main.js": script("slicewalk", "slicewalk/here"),
  });
  execFileSync(join(here, "node_modules/.bin/vite"), ["build", "--logLevel", "error", "--target", "esnext"], { cwd: root });
  const assets = readdirSync(join(root, "dist/assets"));
  const wasm = assets.filter((name) => name.endsWith(".wasm"));
  assert.ok(assets.some((name) => /worker.*\.js$/.test(name)) && wasm.length === 1, assets.join());
  assert.ok(statSync(join(root, "dist/assets", wasm[0])).size > 100_000);
  if (!browser) {
    t.skip("no Chromium here");
    return;
  }
  sound(await inBrowser(join(root, "dist")));
});
