// The archive in the calling thread: the main thread of Node.js, and a worker thread.

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { openAsBlob } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { pathToFileURL } from "node:url";
import { Worker as Thread } from "node:worker_threads";
import { openArchiveHere } from "../dist/here.js";
import { CLEAR, HIT, NOT_LOADED, openArchive, SlicewalkError } from "../dist/index.js";
import { folder, gone, numbers, read, until } from "./local.js";

const path = join(folder, "scene.slices");
const file = pathToFileURL(path);
const refuses =
  (kind, message = /./) =>
  (error) =>
    error instanceof SlicewalkError && error.kind === kind && message.test(error.message);

test("answers at once, like the native engine, what is in memory", async () => {
  const archive = await openArchiveHere(await openAsBlob(path));
  const { now } = archive;
  assert.equal(archive.info.pixelSize, 0.04);
  const boxes = numbers("boxes.f64").subarray(0, 6000);
  const native = read("boxes.answers.u8").subarray(0, 1000);
  const before = now.overlaps(boxes);
  assert.ok(before.includes(NOT_LOADED) && before.every((answer, n) => answer === NOT_LOADED || answer === native[n]));
  await archive.load({ min: [-9, -9, -2], max: [9, 9, 9] });
  assert.deepEqual(now.overlaps(boxes), native);
  assert.deepEqual(now.floor(boxes), numbers("boxes.floors.f64").slice(0, 1000));
  assert.deepEqual(now.sweep(numbers("sweeps.f64").subarray(0, 9000)), numbers("sweeps.answers.f64").slice(0, 1000));
  assert.deepEqual(now.overlapsSpheres(numbers("spheres.f64").subarray(0, 4000)), read("spheres.answers.u8").subarray(0, 1000));
  assert.deepEqual(
    now.overlapsCylinders(numbers("cylinders.f64").subarray(0, 5000)),
    read("cylinders.answers.u8").subarray(0, 1000),
  );
  const rays = numbers("rays.f64").subarray(0, 7000);
  assert.deepEqual(now.castHits(rays), await archive.castHits(rays, { load: true }));
  assert.deepEqual(now.cast(rays), now.castHits(rays).distances);
  const body = { shape: "box", x: 0.5, y: 0.5, height: 1.8, at: [-6, 2, 1.5] };
  const slid = now.moveAndSlide(body, [0, 0.3, -3]);
  assert.ok(slid.contacts.length > 0);
  assert.deepEqual(await archive.moveAndSlide(body, [0, 0.3, -3]), slid);
  assert.equal(now.moveAndSlide(body, [0, 0.3, -3], { iterations: 1 }).contacts.length, 1);
  assert.throws(() => now.overlaps(new Float64Array(7)), refuses("invalid", /rows of 6/));
  assert.throws(() => now.overlaps([0, 0, 0, 1, 1, 1]), refuses("invalid", /Float64Array, found Array/));
  assert.throws(() => now.overlaps(gone()), refuses("invalid", /transferred/));
  assert.throws(() => now.overlapsSpheres(Float64Array.of(0, 0, 0, -1)), refuses("invalid", /^row 0: sphere/));
  assert.throws(() => now.moveAndSlide(body, [0, 0, Number.NaN]), refuses("invalid", /move/));
  assert.equal(archive.error, null);
  archive.close();
  assert.throws(() => now.overlaps(boxes), refuses("aborted"));
  await assert.rejects(archive.overlaps(boxes), refuses("aborted"));
});

test("steps a walker without a frame of delay, and draws", async () => {
  const archive = await openArchiveHere(file);
  const walker = await archive.walker({ at: [-2, 2, 0.2] });
  const first = archive.now.step(walker, 1 / 60, {});
  assert.ok(first.missing > 0 && first.ticks === 0 && walker.state === first, "not loaded is never free");
  await archive.load({ min: [-4, 0, -1], max: [1, 4, 5] });
  for (let n = 0; n < 60; n++) archive.now.step(walker, 1 / 60, {});
  assert.deepEqual([walker.state.ground, walker.state.missing], ["walking", 0]);
  const [x] = walker.state.at;
  for (let n = 0; n < 12; n++) assert.equal(archive.now.step(walker, 1 / 60, { wish: [1, 0] }).steps, 62 + n);
  assert.ok(walker.state.at[0] > x + 0.05);
  // The same walker in the ordinary manner.
  assert.equal((await walker.step(1 / 60, {})).steps, 74);
  assert.throws(() => archive.now.step({}, 1 / 60, {}), refuses("invalid", /walker/));
  assert.throws(() => archive.now.step(walker, Number.NaN, {}), refuses("invalid", /seconds/));
  assert.equal(walker.state.steps, 74);
  const page = await new Promise((resolve) => {
    archive.view({ radius: 3, onPage: resolve, onDrop: () => undefined }).look([0, 0, 1]);
  });
  assert.ok(page.indices.length > 0 && archive.stats.pages.resident >= 0);
  walker.close();
  assert.throws(() => archive.now.step(walker, 1 / 60, {}), refuses("invalid", /closed/));
  archive.close();
});

test("settings of a view hold for a camera at rest", async () => {
  const archive = await openArchiveHere(file);
  const pages = new Set();
  const view = archive.view({ radius: 2, onPage: ({ id }) => pages.add(id), onDrop: () => undefined });
  view.look([0, 0, 1]);
  await until(() => pages.size >= 8);
  view.set({ radius: 8 });
  await until(() => pages.size > 40);
  archive.close();

  const other = await openArchiveHere(new URL("../../../../spec/samples/colours.slices", import.meta.url));
  const { min, max } = other.info.bounds;
  const levels = new Map();
  const onPage = ({ id, key }) => levels.set(id, key.level);
  const distant = other.view({ radius: 1, onPage, onDrop: (id) => levels.delete(id) });
  const hasLevel = () => [...levels.values()].some((level) => level > 0);
  distant.look([min[0], min[1], max[2] + 1]);
  // With these answers the engine has the camera.
  for (let n = 0; n < 2; n++) await other.pageBoxes();
  for (const overview of [true, false, true]) {
    distant.set({ overview });
    await until(() => hasLevel() === overview);
  }
  other.close();
});

test("steps a crowd at once, and none of another archive", async () => {
  const [archive, other] = await Promise.all([openArchiveHere(file), openArchiveHere(file)]);
  const crowd = await archive.crowd({ at: Float64Array.of(-2, 2, 0.2, -3, 2, 0.2) });
  const wishes = Float64Array.of(1, 0, 0, 1, 0, 0);
  assert.ok(archive.now.stepCrowd(crowd, 1 / 60, wishes).missing > 0);
  await archive.load({ min: [-5, 0, -1], max: [1, 4, 5] });
  for (let n = 0; n < 60; n++) archive.now.stepCrowd(crowd, 1 / 60, wishes);
  const { places, missing } = crowd.state;
  assert.ok(missing === 0 && places[0] > -2 && places[3] > -3 && places[0] - places[3] > 0.5 - 1e-6, `${places}`);
  assert.deepEqual((await crowd.step(0, wishes)).places, places);
  assert.throws(() => archive.now.stepCrowd(crowd, -1, wishes), refuses("invalid", /seconds/));
  assert.throws(() => archive.now.stepCrowd(crowd, 0, [...wishes]), refuses("invalid", /wishes/));
  assert.throws(() => archive.now.stepCrowd(crowd, 0, gone()), refuses("invalid", /transferred/));
  const walker = await archive.walker({ at: [-2, 2, 0.2] });
  assert.throws(() => other.now.stepCrowd(crowd, 1 / 60, wishes), refuses("invalid", /crowd of the archive/));
  assert.throws(() => other.now.step(walker, 1 / 60, {}), refuses("invalid", /walker of the archive/));
  crowd.close();
  assert.throws(() => archive.now.stepCrowd(crowd, 1 / 60, wishes), refuses("invalid", /closed/));
  [archive, other].forEach((each) => each.close());
});

test("queries between the parts of a batch that loads spoil nothing", async () => {
  const archive = await openArchiveHere(file, { budgetBytes: 1_000_000 });
  const rows = 3000;
  const boxes = numbers("boxes.f64").subarray(0, 6 * rows);
  let over = false;
  const batch = archive.overlaps(boxes, { load: true }).finally(() => {
    over = true;
  });
  let asked = 0;
  while (!over) {
    const at = 6 * (asked % rows);
    archive.now.overlaps(boxes.subarray(at, at + 6));
    asked += 1;
    await new Promise((resolve) => setImmediate(resolve));
  }
  assert.deepEqual(await batch, read("boxes.answers.u8").subarray(0, rows));
  assert.ok(asked > 3);
  archive.close();
});

test("archives are opened one after another and side by side, and give their memory back", async () => {
  const [one, other] = await Promise.all([openArchiveHere(file), openArchiveHere(await openAsBlob(path))]);
  const box = Float64Array.of(-1, -1, -0.5, 1, 1, 0.5, 50, 50, 50, 51, 51, 51);
  assert.deepEqual(Array.from(await one.overlaps(box, { load: true })), [HIT, CLEAR]);
  one.close();
  assert.deepEqual(Array.from(await other.overlaps(box, { load: true })), [HIT, CLEAR]);
  other.close();
  const gate = new AbortController();
  const opening = openArchiveHere(file, { signal: gate.signal });
  gate.abort();
  await assert.rejects(opening, refuses("aborted"));
  await assert.rejects(openArchiveHere(file, { signal: gate.signal }), refuses("aborted"));
  await assert.rejects(openArchiveHere(new Blob(["<!doctype html>".repeat(100)])), refuses("not-an-archive"));
  await assert.rejects(openArchiveHere(pathToFileURL("/nowhere/scene.slices")), refuses("network", /cannot be read/));
});

test("in a worker thread, and a process ends once its archive is closed", async () => {
  const script = `
    import { openArchiveHere } from ${JSON.stringify(new URL("../dist/here.js", import.meta.url).href)};
    const archive = await openArchiveHere(${JSON.stringify(file.href)});
    await archive.load({ min: [-1, -1, -1], max: [1, 1, 1] });
    const answer = archive.now.overlaps(Float64Array.of(-1, -1, -0.5, 1, 1, 0.5))[0];
    archive.close();
  `;
  const inThread = `${script}(await import("node:worker_threads")).parentPort.postMessage(answer);`;
  const thread = new Thread(new URL(`data:text/javascript,${encodeURIComponent(inThread)}`));
  const ended = new Promise((resolve) => thread.on("exit", resolve));
  const answer = await new Promise((resolve, reject) => thread.on("message", resolve).on("error", reject));
  assert.deepEqual([answer, await ended], [HIT, 0]);
  const run = spawnSync(process.execPath, ["--input-type=module", "-e", `${script}console.log(answer)`], {
    encoding: "utf8",
    timeout: 30_000,
  });
  assert.deepEqual([run.status, run.stdout.trim()], [0, String(HIT)], run.stderr);
});

test("archives that a fresh process opens at once share one engine", () => {
  const here = JSON.stringify(new URL("../dist/here.js", import.meta.url).href);
  const files = JSON.stringify([file.href, new URL("../../../../spec/samples/stairs.slices", import.meta.url).href]);
  const run = (opening) => {
    const script = `
      import { openArchiveHere } from ${here};
      let instances = 0;
      const { instantiate } = WebAssembly;
      WebAssembly.instantiate = (...given) => {
        instances += 1;
        return instantiate(...given);
      };
      const files = ${files};
      for (const archive of ${opening}) {
        const { min, max } = archive.info.bounds;
        await archive.load({ min, max });
        const low = Float64Array.from({ length: 600 }, (_, n) => min[n % 3] + (((n * 37) % 101) / 101) * (max[n % 3] - min[n % 3]));
        const boxes = low.map((v, n) => (n % 6 < 3 ? v : low[n - 3] + 0.1));
        console.log(archive.info.pixelSize, archive.now.overlaps(boxes).join(""));
        archive.close();
      }
      console.log(instances);`;
    const { status, stdout, stderr } = spawnSync(process.execPath, ["--input-type=module", "-e", script], {
      encoding: "utf8",
      timeout: 60_000,
    });
    assert.equal(status, 0, stderr);
    return stdout;
  };
  // Node.js may make other instances for itself, but as many in both.
  const apart = run("[await openArchiveHere(files[0]), await openArchiveHere(files[1])]");
  assert.equal(run("await Promise.all(files.map((name) => openArchiveHere(name)))"), apart);
});

test("where there are no workers, openArchive names the way out", async () => {
  await assert.rejects(openArchive("http://host/scene.slices"), refuses("engine", /openArchiveHere from "slicewalk\/here"/));
});
