// The page as users get it: from `slicetool serve`, under its policy, and from the folder of `slicetool site`.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { beforeEach, describe } from "node:test";
import { drop, hold, it, pages, until, walkIn } from "./browser.js";
import { BIN, DIST, house, other, program } from "./scans.js";
import { magentaCube } from "./splats.js";
import { StaticServer } from "./static-server.js";

let page, folder;
const tests = pages({
  async begin() {
    folder = mkdtempSync(join(tmpdir(), "slicewalk-hosts-"));
  },
  async end() {
    rmSync(folder, { recursive: true });
  },
});

beforeEach(() => {
  page = tests.page;
});

/** Starts `slicetool serve`; returns its address and how it ends. */
async function serve(...args) {
  const child = spawn(join(BIN, "slicetool"), ["serve", ...args, "--page", DIST], { stdio: ["ignore", "pipe", "inherit"] });
  const ended = new Promise((resolve) => child.once("exit", resolve));
  const line = await new Promise((resolve, reject) => {
    let text = "";
    child.stdout.on("data", (bytes) => {
      text += bytes;
      if (text.includes("\n")) resolve(text.split("\n")[0]);
    });
    child.once("exit", () => reject(new Error("slicetool serve ended")));
  });
  assert.match(line, /^http:\/\/127\.0\.0\.1:\d+\/$/);
  return {
    address: line,
    async stop() {
      child.kill("SIGINT");
      const late = setTimeout(() => child.kill("SIGKILL"), 10_000);
      return ended.finally(() => clearTimeout(late));
    },
  };
}

describe("hosts", () => {
  it("walks in what slicetool serves, and chooses among several archives", async () => {
    const server = await serve(house(), other());
    try {
      await walkIn(page, server.address);
      await hold(page, ["w"], "walking", ({ speed }) => speed > 0.5);
      await page.getByRole("button", { name: "Open another archive" }).click();
      await page.getByRole("button", { name: "other.slices" }).click();
      await page.getByRole("heading", { name: "other.slices", level: 1 }).waitFor();
      await until(page, "ready", ({ ready }) => ready);
    } finally {
      assert.equal(await server.stop(), 130);
    }
  });

  it(
    "draws as much of a point cloud as the eye can tell apart",
    { skip: cloud() === null ? "SLICEWALK_DATA has no COPC file" : false },
    async () => {
      const archive = join(folder, "cloud.slices");
      program("sliceconv", cloud(), "-o", archive, "--quiet", "--force", "--units", "m", "--pixel", "10");
      const { nodes, cube, spacing } = await hierarchy(cloud());
      // The archive counts heights and places as the file does: metres here.
      const wanted = (eye) => {
        const [focal, pixel] = [250 / Math.tan((70 / 2) * (Math.PI / 180)), 10];
        const far = Math.max(20, (pixel * focal) / 2);
        const isWanted = (name) => {
          const [depth, ...at] = name.split("-").map(Number);
          const edge = (cube[3] - cube[0]) / 2 ** depth;
          const apart = [0, 1, 2].map((n) => {
            const low = cube[n] + at[n] * edge;
            return Math.max(low - eye[n], 0, eye[n] - low - edge);
          });
          const away = Math.hypot(...apart);
          return depth === 0 || (away <= far && (2 * spacing) / 2 ** depth / away >= 1.5 / focal);
        };
        // A node's parents have wider gaps and are nearer.
        return Object.entries(nodes)
          .filter(([name]) => isWanted(name))
          .reduce((sum, [, { pointCount }]) => sum + pointCount, 0);
      };
      const server = await serve(archive, "--cloud", cloud());
      try {
        await walkIn(page, `${server.address}?archive=cloud.slices&at=636000,849200,420&look=0,0`);
        await page.getByRole("button", { name: "Fly" }).click();
        await page.getByRole("button", { name: "Colours" }).click();
        await page.getByLabel("Point cloud").check();
        await page.getByText(/Point cloud: [\d,]+ points drawn/).waitFor();
        const counts = [];
        for (const at of [
          [635700, 849000, 450],
          [639900, 853000, 450],
          [637900, 851200, 6000],
          [635700, 849000, 450],
        ]) {
          await page.evaluate((at) => void window.slicewalk.goto({ at }).catch(() => {}), at);
          const { at: there } = await until(page, "there", (now) => Math.hypot(now.at[0] - at[0], now.at[2] - at[2]) < 1);
          const points = wanted([there[0], there[1], there[2] + 1.65]);
          await until(page, `${points} points`, ({ drawn }) => drawn.points === points);
          counts.push(points);
        }
        assert.ok(new Set(counts).size > 2 && Math.min(...counts) > 0, `${counts}`);
      } finally {
        await server.stop();
      }
    },
  );

  it("draws Gaussian splats under its policy", async () => {
    const server = await serve(house());
    try {
      await walkIn(page, server.address);
      await drop(page, "cube.ply", magentaCube());
      await page.getByText("Gaussian splats: 27 drawn.").waitFor();
    } finally {
      await server.stop();
    }
  });

  it("walks in a site below any path, which names the licences of all its parts", async () => {
    program("slicetool", "site", house(), "-o", join(folder, "below/this"), "--page", DIST);
    const server = await new StaticServer(folder).start();
    try {
      await walkIn(page, `${server.address}below/this/index.html`);
      await hold(page, ["w"], "walking", ({ speed }) => speed > 0.5);
      const licences = readFileSync(join(folder, "below/this/licences.txt"), "utf8");
      for (const part of ["three 0.", "nipplejs ", "wasm-bindgen ", "zstd"]) assert.ok(licences.includes(part), part);
    } finally {
      await server.stop();
    }
  });
});

/** A COPC file whose hierarchy has two pages. */
function cloud() {
  const path = join(process.env.SLICEWALK_DATA ?? "", "odd/simple_with_page.copc.laz");
  return process.env.SLICEWALK_DATA && existsSync(path) ? path : null;
}

/** All nodes of a COPC file, by a reader of its own. */
async function hierarchy(path) {
  const bytes = readFileSync(path);
  const number = (at) => bytes.readDoubleLE(at);
  const u64 = (at) => Number(bytes.readBigUInt64LE(at));
  // The COPC header follows that of LAS 1.4 and the header of its record: middle, half an edge, spacing, root page.
  const [info, half] = [375 + 54, number(375 + 54 + 24)];
  const middle = [0, 8, 16].map((at) => number(info + at));
  const cube = [...middle.map((value) => value - half), ...middle.map((value) => value + half)];
  const nodes = {};
  const read = (offset, length) => {
    for (let at = offset; at < offset + length; at += 32) {
      const name = [0, 4, 8, 12].map((n) => bytes.readInt32LE(at + n)).join("-");
      const pointCount = bytes.readInt32LE(at + 28);
      if (pointCount === -1) read(u64(at + 16), bytes.readInt32LE(at + 24));
      else nodes[name] = { pointCount };
    }
  };
  read(u64(info + 40), u64(info + 48));
  return { nodes, cube, spacing: number(info + 32) };
}
