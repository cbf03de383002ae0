// Scans on the page: dropped, converted, walked in and saved; refused and cancelled ones; what the server converts; kiosks.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, describe } from "node:test";
import { drop, it, pages, state, until, walkIn } from "./browser.js";
import { BIN, DIST, house, program, WAY } from "./scans.js";
import { StaticServer } from "./static-server.js";

const folder = mkdtempSync(join(tmpdir(), "page-"));
const scan = join(folder, "house.laz");
const splats = join(folder, "splats.ply");
const OPTIONS = { units: "m", pixel: 0.1 };
let server;

before(async () => {
  program("scangen", "demo", "--format", "7", "--colour", "4", "-o", scan);
  program("scangen", "corridor", "--density", "400", "-o", splats);
  writeFileSync(join(folder, "wrong.laz"), "this is no scan");
  writeFileSync(join(folder, "alone.png"), "this is no scan");
  writeFileSync(join(folder, "empty.slices"), "");
  writeFileSync(join(folder, "wall.obj"), "mtllib wall.mtl\nusemtl wall\nv 0 0 0\nv 4 0 0\nv 0 0 3\nf 1 2 3\n");
  writeFileSync(join(folder, "wall.mtl"), "newmtl wall\nKd 0.8 0.2 0.1\n");
  writeFileSync(join(folder, "cut.laz"), readFileSync(scan).subarray(0, 200_000));
  writeFileSync(join(folder, "route.csv"), '"x","y","z"\n1.5,2,0\n"3.8","5","0"\n6.4,5,0\n');
  const settings = {
    title: { en: "The house", de: "Das Haus" },
    start: { at: WAY.start, look: [90, 0] },
    modes: ["walk", "plan"],
    stops: [{ at: [1.5, 2, 0], caption: "The door", radius: 2 }],
  };
  writeFileSync(join(folder, "settings.json"), JSON.stringify(settings));
  writeFileSync(join(folder, "plain.json"), "{}");
  writeFileSync(join(folder, "walk.json"), '{"modes": ["walk"]}');
  server = await new StaticServer(DIST, {
    "/house.slices": house(),
    "/settings.json": join(folder, "settings.json"),
    "/plain.json": join(folder, "plain.json"),
    "/walk.json": join(folder, "walk.json"),
    "/route.csv": join(folder, "route.csv"),
  }).start();
});
after(async () => {
  await server?.stop();
  rmSync(folder, { recursive: true, force: true });
});

/** The bytes that `sliceconv` writes with the page's options. */
function natively(options, input = scan) {
  const output = join(folder, "native.slices");
  const words = Object.entries(options).flatMap(([name, value]) => [`--${name}`, String(value)]);
  program("sliceconv", input, "-o", output, "--quiet", "--force", "--colour", "auto", "--levels", "on", ...words);
  return readFileSync(output);
}

async function saved(page) {
  const base64 = await page.evaluate(async () => {
    const bytes = new Uint8Array(await (await window.slicewalk.save()).arrayBuffer());
    let text = "";
    for (let at = 0; at < bytes.length; at += 32768) text += String.fromCharCode(...bytes.subarray(at, at + 32768));
    return btoa(text);
  });
  return Buffer.from(base64, "base64");
}

/** Whether a click in the middle of what is found reaches it. */
const isReached = (locator) =>
  locator.evaluate((element) => {
    const { left, top, width, height } = element.getBoundingClientRect();
    return element.contains(document.elementFromPoint(left + width / 2, top + height / 2));
  });

/** Converts what the page asks about, as it proposes. */
async function agree(page, name) {
  const dialog = page.getByRole("dialog", { name: `Convert ${name}` });
  await dialog.getByRole("button", { name: "Convert and walk in" }).click();
  await page.getByRole("button", { name: "Save as .slices" }).waitFor();
}

/** Names of what conversions keep in the browser's private files. */
const kept = (page) =>
  page.evaluate(async () => {
    const root = await (await navigator.storage.getDirectory()).getDirectoryHandle("slicewalk-conversions");
    return Array.fromAsync(root.keys());
  });

const choose = (page, ...names) => page.locator("#open-file").setInputFiles(names.map((name) => join(folder, name)));

describe("scans on the page", () => {
  const tests = pages();

  it("a chosen scan is described, converted, walked in and saved", async () => {
    const { page } = tests;
    await page.goto(server.address);
    await choose(page, "house.laz");
    const dialog = page.getByRole("dialog", { name: "Convert house.laz" });
    await dialog.getByText("Nothing leaves this computer.").waitFor();
    await dialog.getByLabel("Unit").selectOption("m");
    await dialog.getByLabel("Edge of a pixel (m)").fill("0.1");
    await dialog.getByRole("button", { name: "Convert and walk in" }).click();
    await until(page, "the walk", ({ ready }) => ready);
    assert.ok((await saved(page)).equals(natively(OPTIONS)));
    await page.getByRole("button", { name: "Save as .slices" }).waitFor();
    for (const name of ["Walk in", "Save as .slices", "×"]) {
      assert.ok(await isReached(page.getByRole("button", { name, exact: true })), name);
    }
    const { converting, error } = await state(page);
    assert.deepEqual([converting, error], [null, null]);
  });

  it("splats and models of the same ending are told apart, wherever they are dropped", async () => {
    const { page } = tests;
    await page.goto(server.address);
    await page.getByRole("heading", { name: "Walk in a laser scan" }).waitFor();
    const corner = (x, y) => `${x} ${y} 0\n`;
    const rows = [corner(0, 0), corner(4, 0), corner(4, 3), corner(0, 3)].join("");
    const head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n";
    const faces = "element face 2\nproperty list uchar int vertex_indices\nend_header\n";
    const model = Buffer.from(`${head}${faces}${rows}3 0 1 2\n3 0 2 3\n`);
    await drop(page, "splats.ply", readFileSync(splats));
    await agree(page, "splats.ply");
    assert.ok(await isReached(page.getByRole("button", { name: "Walk in" })));
    await drop(page, "model.ply", model);
    await agree(page, "model.ply");
    await page.getByRole("heading", { name: "model.slices", level: 1 }).waitFor();
  });

  it("a model is converted with the materials that are dropped beside it, and says what it did without", async () => {
    const { page } = tests;
    await page.goto(server.address);
    // Browsers list files by name, so what a model names may come first.
    await choose(page, "wall.mtl", "wall.obj");
    await agree(page, "wall.obj");
    await page.getByRole("heading", { name: "wall.slices", level: 1 }).waitFor();
    assert.equal(await page.getByText("What was left out or assumed").isVisible(), false);
    assert.ok((await saved(page)).equals(natively({ units: "m" }, join(folder, "wall.obj"))));
    await choose(page, "wall.obj");
    await page.getByText("What was left out or assumed").waitFor({ state: "hidden" });
    await agree(page, "wall.obj");
    await page.getByText("What was left out or assumed").click();
    await page.getByText("wall.obj: materials: cannot read wall.mtl: it is not among the files given").waitFor();
  });

  it("the form asks for the unit that a file does not state and for the axis up, and takes a scan by its address", async () => {
    const { page } = tests;
    const corners = new Float32Array([0, 0, 0, 4, 0, 0, 0, 3, 0]);
    const uri = `data:;base64,${Buffer.from(corners.buffer).toString("base64")}`;
    const model = {
      asset: { version: "2.0" },
      buffers: [{ uri, byteLength: 36 }],
      bufferViews: [{ buffer: 0, byteLength: 36 }],
      accessors: [{ bufferView: 0, componentType: 5126, count: 3, type: "VEC3" }],
      meshes: [{ primitives: [{ attributes: { POSITION: 0 } }] }],
      nodes: [{ mesh: 0 }],
    };
    server.files["/stated.gltf"] = join(folder, "stated.gltf");
    writeFileSync(server.files["/stated.gltf"], JSON.stringify(model));
    await page.goto(server.address);
    await page.getByLabel("Address of an archive").fill("stated.gltf");
    await page.getByRole("button", { name: "Open", exact: true }).click();
    await page.getByRole("dialog", { name: "Convert stated.gltf" }).getByText("as stated (m)").waitFor({ state: "attached" });
    await page.getByRole("button", { name: "Cancel" }).click();
    // Without a scan, nothing to act on would remain.
    await page.getByRole("heading", { name: "Walk in a laser scan" }).waitFor();
    await choose(page, "splats.ply");
    const dialog = page.getByRole("dialog", { name: "Convert splats.ply" });
    await dialog.getByText("not stated: metres").waitFor({ state: "attached" });
    // Training programs mostly write y down.
    await dialog.getByLabel("Axis that points up").selectOption("-y");
    await dialog.getByLabel("Edge of a pixel (m)").fill("0.1");
    await dialog.getByRole("button", { name: "Convert and walk in" }).click();
    await page.getByRole("button", { name: "Save as .slices" }).waitFor();
    assert.ok((await saved(page)).equals(natively({ ...OPTIONS, up: "-y" }, splats)));
  });

  it("a refusal offers what would help: to take what can be read, or to ask again", async () => {
    const { page } = tests;
    writeFileSync(join(folder, "point.xyz"), "1 2 3\n");
    const short = join(folder, "short.las");
    program("scangen", "house", "--param", "storeys=1", "--density", "100", "-o", short);
    const whole = readFileSync(short);
    writeFileSync(short, whole.subarray(0, whole.length - 50));
    await page.goto(server.address);
    await choose(page, "short.las");
    await page.getByRole("button", { name: "Take what can be read" }).click();
    await agree(page, "short.las");
    await page.getByText("What was left out or assumed").waitFor();
    await choose(page, "wall.obj", "wall.mtl");
    const start = page.getByRole("button", { name: "Convert and walk in" });
    await page.getByLabel("Axis that points up").selectOption("-y");
    await start.click();
    await page.getByText("meshes are turned by").waitFor();
    await page.getByRole("button", { name: "Change the options" }).click();
    await page.getByRole("button", { name: "Cancel" }).click();
    await choose(page, "point.xyz");
    await start.click();
    await page.getByRole("button", { name: "Change the options" }).click();
    await page.getByLabel("Edge of a pixel (m)").fill("0.1");
    await start.click();
    await page.getByRole("heading", { name: "point.slices", level: 1 }).waitFor();
  });

  it("names a folder that is dropped", async () => {
    const { page } = tests;
    await page.goto(server.address);
    await page.waitForFunction(() => window.slicewalk !== undefined);
    const session = await page.context().newCDPSession(page);
    for (const type of ["dragEnter", "dragOver", "drop"]) {
      const data = { items: [], files: [folder], dragOperationsMask: 1 };
      await session.send("Input.dispatchDragEvent", { type, x: 400, y: 250, data });
    }
    await page.getByText("cannot be read. It is a folder, or it was moved or changed.").waitFor();
  });

  it("a program opens a scan by its address and hears of its progress", async () => {
    const { page } = tests;
    server.files["/scan.laz"] = scan;
    await page.goto(server.address);
    await page.waitForFunction(() => window.slicewalk !== undefined);
    const stages = await page.evaluate(async (options) => {
      const stages = new Set();
      const timer = setInterval(() => stages.add(window.slicewalk.state().converting?.stage), 5);
      await window.slicewalk.open("scan.laz", options);
      clearInterval(timer);
      return [...stages];
    }, OPTIONS);
    assert.ok(stages.includes("reading points"), stages.join());
    assert.equal((await state(page)).ready, true);
    assert.ok((await saved(page)).equals(natively(OPTIONS)));
    // The archive lasts until another one is open.
    assert.equal((await kept(page)).length, 1);
    await page.evaluate(() => window.slicewalk.open("house.slices"));
    while ((await kept(page)).length > 0) await page.waitForTimeout(20);
  });

  it("splats are converted as sliceconv does", async () => {
    const { page } = tests;
    server.files["/splats.ply"] = splats;
    await page.goto(server.address);
    await page.waitForFunction(() => window.slicewalk !== undefined);
    await page.evaluate((options) => window.slicewalk.open("splats.ply", options), OPTIONS);
    assert.equal((await state(page)).ready, true);
    assert.ok((await saved(page)).equals(natively(OPTIONS, splats)));
  });

  it("wrong, damaged and cancelled scans leave the open scene", async () => {
    const { page } = tests;
    await walkIn(page, `${server.address}?archive=house.slices&at=${WAY.start}`);
    for (const name of ["wrong.laz", "cut.laz", "alone.png"]) {
      await choose(page, name);
      await page.getByRole("heading", { name: "This file cannot be converted" }).waitFor();
      await page.getByText(name).first().waitFor();
      await page.getByRole("dialog").getByRole("button", { name: "Cancel" }).click();
      assert.equal((await state(page)).ready, true);
    }
    await choose(page, "wall.obj", "empty.slices");
    await page.getByText("empty.slices is an archive. Open it alone").waitFor();
    await page.getByRole("dialog").getByRole("button", { name: "Cancel" }).click();
    const several = await page.evaluate(() => {
      const files = ["a.slices", "b.laz"].map((name) => new File(["x"], name));
      return window.slicewalk.open(files).catch((error) => error.kind);
    });
    assert.equal(several, "invalid");
    const wrong = await page.evaluate(() =>
      Promise.all(
        [undefined, null, {}, [], ["scan.laz"], 5].map((given) => window.slicewalk.open(given).catch(({ kind }) => kind)),
      ),
    );
    assert.deepEqual(wrong, Array(6).fill("invalid"));
    const reason = await page.evaluate(async () => {
      const bytes = await (await fetch("scan.laz")).arrayBuffer();
      const opening = window.slicewalk.open(new File([bytes], "scan.laz"), { units: "m", pixel: 0.02 });
      while (window.slicewalk.state().converting === null) await new Promise((resolve) => setTimeout(resolve, 0));
      document.querySelector(".converting button").click();
      return opening.then(
        () => "converted",
        (error) => error.kind,
      );
    });
    assert.equal(reason, "aborted");
    const { ready, converting } = await state(page);
    assert.deepEqual([ready, converting], [true, null]);
    const refused = await page.evaluate(() =>
      window.slicewalk.open(new File(["x"], "a.laz"), { no_such_option: 1 }).catch((error) => error.message),
    );
    assert.match(refused, /no_such_option/);
    // Calls that open nothing say why, and so do those that another one overtakes.
    const kinds = await page.evaluate(async () => {
      const bad = () => window.slicewalk.open(new File(["no archive ".repeat(400)], "bad.slices"));
      const calls = await Promise.allSettled([bad(), bad()]);
      return calls.map(({ status, reason }) => reason?.kind ?? status);
    });
    assert.deepEqual(kinds, ["aborted", "not-an-archive"]);
    await page.getByRole("button", { name: "Stay here" }).click();
    assert.equal((await state(page)).ready, true);
  });

  it("a full storage is named, nothing is left in it, and the open scene stays", async () => {
    const { page } = tests;
    await walkIn(page, `${server.address}?archive=house.slices&at=${WAY.start}`);
    const browser = await page.context().newCDPSession(page);
    const { origin } = new URL(server.address);
    await browser.send("Storage.overrideQuotaForOrigin", { origin, quotaSize: 20_000 });
    await choose(page, "house.laz");
    await page.getByRole("button", { name: "Convert and walk in" }).click();
    const dialog = page.getByRole("dialog", { name: "This file cannot be converted" });
    await dialog.getByText(/^\/browser storage.*: cannot write .*: no storage space/).waitFor();
    await dialog.getByText("The browser's storage is full.").waitFor();
    await dialog.getByRole("button", { name: "Cancel" }).click();
    assert.equal((await state(page)).ready, true);
    assert.deepEqual(await kept(page), []);
  });

  it("the next page removes what a conversion leaves that its page did not outlive", async () => {
    const { page } = tests;
    await page.goto(server.address);
    await page.waitForFunction(() => window.slicewalk !== undefined);
    await choose(page, "house.laz");
    await page.locator("#conversion-pixel").fill("0.005");
    await page.getByRole("button", { name: "Convert and walk in" }).click();
    await page.waitForFunction(() => window.slicewalk.state().converting !== null);
    while ((await kept(page)).length === 0) await page.waitForTimeout(20);
    await page.reload();
    while ((await kept(page)).length > 0) await page.waitForTimeout(20);
    await page.waitForFunction(() => window.slicewalk !== undefined);
  });

  it("without private files the conversion works in memory", async () => {
    const { page } = tests;
    await page.addInitScript(() => {
      Object.defineProperty(StorageManager.prototype, "getDirectory", { value: () => Promise.reject(new Error("none")) });
    });
    await page.goto(server.address);
    await page.waitForFunction(() => window.slicewalk !== undefined);
    await page.evaluate((options) => window.slicewalk.open("scan.laz", options), OPTIONS);
    assert.ok((await saved(page)).equals(natively(OPTIONS)));
  });

  it("the server converts a scan while the page waits", async () => {
    const { page } = tests;
    const words = ["serve", scan, "--units", "m", "--pixel", "0.1", "--page", DIST];
    const child = spawn(join(BIN, "slicetool"), words, { stdio: ["ignore", "pipe", "inherit"] });
    try {
      const address = await new Promise((resolve) => child.stdout.once("data", (text) => resolve(String(text).trim())));
      await page.goto(address);
      await until(page, "the walk", ({ ready }) => ready);
      assert.ok((await saved(page)).equals(natively(OPTIONS)));
    } finally {
      child.kill("SIGINT");
      await new Promise((resolve) => child.once("exit", resolve));
    }
  });
});

describe("kiosk", () => {
  const tests = pages();

  it("walks the tour until someone touches, and returns when nobody does", async () => {
    const { page } = tests;
    await page.addInitScript(() => {
      const buttons = Array.from({ length: 17 }, () => ({ pressed: false, value: 0 }));
      window.pad = { connected: true, mapping: "standard", axes: [0, 0, 0, 0], buttons };
      navigator.getGamepads = () => [window.pad];
    });
    await page.goto(`${server.address}?archive=house.slices&kiosk=4&tour=route.csv&lang=de`);
    const { kiosk } = await until(page, "the tour", ({ ready, kiosk }) => ready && kiosk?.touring);
    assert.equal(kiosk.seconds, 4);
    await page.getByRole("heading", { name: "Das Haus" }).waitFor();
    await until(page, "a walk", ({ at }) => Math.hypot(at[0] - 1.5, at[1] - 2) > 0.3);
    const forward = page.getByRole("button", { name: "Vorwärts" });
    await forward.click();
    assert.equal((await state(page)).kiosk.touring, false);
    const { width, height } = await forward.boundingBox();
    assert.ok(width >= 88 && height >= 88, `${width} × ${height}`);
    assert.equal(await page.getByRole("button", { name: "Einstellungen" }).isVisible(), false);
    assert.equal(await page.getByRole("button", { name: "Von außen" }).count(), 0);
    const back = await until(page, "the start", ({ kiosk }) => kiosk.touring);
    assert.ok(Math.hypot(back.at[0] - 1.5, back.at[1] - 2) < 1, JSON.stringify(back.at));
    await page.evaluate(() => (window.pad.axes[2] = 1));
    await until(page, "the tour ended by a gamepad", ({ kiosk }) => !kiosk.touring);
  });

  it("stays while a control is held, returns to the first view, and offers no other views", async () => {
    const { page } = tests;
    await page.goto(`${server.address}?archive=house.slices&kiosk=6&settings=walk.json&lang=en`);
    const walkIn = page.getByRole("button", { name: "Walk in" });
    const forward = page.getByRole("button", { name: "Forward" });
    await walkIn.click({ force: true });
    const { at: from } = await until(page, "the walk", ({ mode, ready }) => ready && mode === "walk");
    await forward.hover();
    await page.mouse.down();
    await page.waitForTimeout(7900);
    const { at, mode, kiosk } = await state(page);
    assert.ok(mode === "walk" && kiosk.idle < 1.6, JSON.stringify({ mode, kiosk }));
    assert.ok(Math.hypot(at[0] - from[0], at[1] - from[1]) > 0.3, `${from} to ${at}`);
    await page.mouse.up();
    for (const key of ["m", "o", "f"]) await page.keyboard.press(key);
    await page.waitForTimeout(300);
    const still = await state(page);
    assert.ok(still.mode === "walk" && still.ground !== "flying", JSON.stringify(still));
    await walkIn.waitFor();
    assert.equal((await state(page)).mode, "orbit");
    // By a key, as by a finger.
    await forward.focus();
    await page.keyboard.down("Enter");
    await until(page, "walking", ({ speed }) => speed > 0.5);
    await page.keyboard.up("Enter");
    await until(page, "standing", ({ speed }) => speed === 0);
  });

  it("opens again what did not open at first, with its tour, and offers nothing else", async () => {
    const { page } = tests;
    await page.goto(`${server.address}?archive=later.slices&kiosk=60&tour=route.csv&lang=en`);
    const again = page.getByRole("dialog").getByRole("button", { name: "Open again" });
    await again.waitFor();
    assert.equal(await page.getByRole("button", { name: "Open another archive" }).count(), 0);
    server.files["/later.slices"] = house();
    await again.click();
    await until(page, "the tour", ({ ready, kiosk }) => ready && kiosk?.touring);
    page.failedRequests.length = 0;
  });

  it("shows one archive, whatever is dropped or pressed, under its title", async () => {
    const { page } = tests;
    await page.goto(`${server.address}?archive=house.slices&kiosk=60&settings=settings.json&lang=en`);
    await until(page, "ready", ({ ready }) => ready);
    assert.equal(await page.title(), "The house");
    await drop(page, "splats.ply", readFileSync(splats));
    await drop(page, "points.xyz", Buffer.from("0 0 0\n1 0 0\n"));
    await page.keyboard.press("h");
    await page.waitForTimeout(1500);
    assert.equal(await page.getByRole("dialog").count(), 0);
    assert.equal((await state(page)).drawn.splats, 0);
  });

  it("does not leave the first view while nobody walks", async () => {
    const { page } = tests;
    await page.goto(`${server.address}?archive=house.slices&kiosk=1&settings=plain.json&lang=en`);
    await until(page, "ready", ({ ready }) => ready);
    // Turned once, and then left alone for longer than the idle time.
    await page.mouse.move(400, 200);
    await page.mouse.wheel(0, 10);
    const modes = await page.evaluate(async () => {
      const modes = new Set();
      for (const end = performance.now() + 4000; performance.now() < end;) {
        modes.add(window.slicewalk.state().mode);
        await new Promise(requestAnimationFrame);
      }
      return [...modes];
    });
    assert.deepEqual(modes, ["orbit"]);
  });

  it("runs with settings that make no sense", async () => {
    const { page } = tests;
    for (const stops of ["[null, 3, {}]", "{}"]) {
      writeFileSync(join(folder, "odd.json"), `{"title": 5, "start": "here", "modes": {}, "stops": ${stops}}`);
      server.files["/odd.json"] = join(folder, "odd.json");
      await page.goto(`${server.address}?archive=house.slices&kiosk=4&settings=odd.json&lang=en`);
      await until(page, "ready", ({ ready, kiosk }) => ready && kiosk?.idle > 0.5);
      assert.ok(await isReached(page.getByRole("button", { name: "Walk in" })));
    }
  });

  for (const [width, height] of [
    [390, 844],
    [640, 360],
    [1080, 1920],
  ]) {
    it(`keeps its controls apart and in sight on ${width} × ${height}, and marks the view that is shown`, async () => {
      const kiosk = await tests.browser.newPage({ viewport: { width, height }, hasTouch: true });
      try {
        await kiosk.goto(`${server.address}?archive=house.slices&kiosk=300&settings=plain.json&lang=en`);
        await until(kiosk, "ready", ({ ready }) => ready);
        const walkIn = kiosk.getByRole("button", { name: "Walk in" });
        const controls = kiosk.locator(".kiosk-controls button");
        for (const button of [walkIn, ...(await controls.all())]) assert.ok(await isReached(button), await button.innerText());
        await walkIn.click();
        await kiosk.locator(".kiosk-controls button[aria-pressed=true]", { hasText: "Walk" }).waitFor();
        assert.deepEqual(kiosk.complaints, []);
      } finally {
        await kiosk.end();
      }
    });
  }

  it("shows the captions of stops", async () => {
    const { page } = tests;
    await page.goto(`${server.address}?archive=house.slices&settings=settings.json&lang=en`);
    await until(page, "the caption", ({ kiosk }) => kiosk?.caption === "The door");
    await page.evaluate(() => window.slicewalk.goto({ at: [6.4, 5, 0] }));
    await until(page, "no caption", ({ kiosk }) => kiosk.caption === null);
  });
});
