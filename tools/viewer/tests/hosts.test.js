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
    "draws a point cloud over the archive",
    {
      skip: cloud() === null ? "SLICEWALK_DATA has no COPC file" : false,
    },
    async () => {
      const server = await serve(house(), "--cloud", cloud());
      try {
        await walkIn(page, server.address);
        await page.getByRole("button", { name: "Colours" }).click();
        await page.getByLabel("Point cloud").check();
        await page.getByText(/Point cloud: [\d,]+ points drawn/).waitFor();
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

function cloud() {
  const path = join(process.env.SLICEWALK_DATA ?? "", "odd/1.2-with-color.copc.laz");
  return process.env.SLICEWALK_DATA && existsSync(path) ? path : null;
}
