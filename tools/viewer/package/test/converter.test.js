// Converters with a worker that answers what the tests tell it to.

import assert from "node:assert/strict";
import { test } from "node:test";
import { ConversionError, Converter, mainOf } from "../dist/convert/index.js";
import { SlicewalkError } from "../dist/index.js";

class Stub {
  requests = [];
  terminated = false;

  postMessage(request) {
    structuredClone(request.options);
    this.requests.push(request);
  }

  terminate() {
    this.terminated = true;
  }

  answer(data) {
    this.onmessage({ data });
  }

  fail(message) {
    this.onerror({ preventDefault: () => undefined, message });
  }
}

function begin(files = [new File(["x"], "a.laz")]) {
  const workers = [];
  const worker = () => {
    workers.push(new Stub());
    return workers.at(-1);
  };
  return { converter: new Converter(files, { worker }), workers };
}

const refuses =
  (kind, message = /./) =>
  (error) =>
    error instanceof ConversionError && error.kind === kind && message.test(error.message);
const tasks = (worker) => worker.requests.map(({ task }) => task);
const turn = () => new Promise((resolve) => setTimeout(resolve, 5));

test("a converter that is closed before its worker is asked converts nothing, and takes another request", async () => {
  const { converter, workers } = begin();
  const cancelled = converter.convert();
  converter.close();
  const preview = converter.preview({ units: "m" });
  await assert.rejects(cancelled, refuses("aborted"));
  assert.equal(workers.length, 1);
  assert.deepEqual([tasks(workers[0]), workers[0].terminated], [["preview"], false]);
  workers[0].answer({ answer: { preview: { points: 1 } }, archive: null });
  assert.deepEqual(await preview, { points: 1 });
});

test("a second request is refused while one runs, and leaves it alone", async () => {
  const { converter, workers } = begin();
  const first = converter.preview();
  await assert.rejects(
    converter.convert({}, () => undefined),
    refuses("invalid", /another request/),
  );
  await assert.rejects(converter.preview(), refuses("invalid", /another request/));
  workers[0].answer({ answer: { preview: { points: 1 } }, archive: null });
  assert.deepEqual(await first, { points: 1 });
  const told = [];
  const second = converter.convert({ pixel: 0.1 }, (now) => told.push(now));
  await turn();
  assert.deepEqual(tasks(workers[0]), ["preview", "convert"]);
  workers[0].answer({ stage: "reading", total: 10, unit: "points" });
  workers[0].answer({ done: 5 });
  workers[0].answer({ warning: "few points" });
  const archive = new File(["y"], "a.slices");
  workers[0].answer({ answer: { report: { pages: 1 } }, archive });
  const converted = await second;
  assert.deepEqual([converted.archive, converted.report, converted.warnings], [archive, { pages: 1 }, ["few points"]]);
  assert.deepEqual(told.at(-1), { stage: "reading", share: 0.5 });
});

test("a request that is cancelled hears nothing more of its worker", async () => {
  const { converter, workers } = begin();
  const told = [];
  const cancelled = converter.convert({}, (now) => told.push(now));
  await turn();
  converter.close();
  const next = converter.preview();
  workers[0].answer({ stage: "reading", total: 10, unit: "points" });
  workers[0].fail("terminated");
  await assert.rejects(cancelled, refuses("aborted"));
  assert.deepEqual([told.length, workers[0].terminated, workers[1].terminated], [1, true, false]);
  workers[1].answer({ answer: { preview: {} }, archive: null });
  assert.deepEqual(await next, {});
});

test("a worker that fails says why", async () => {
  for (const [fail, kind, message] of [
    [(worker) => worker.answer({ fault: "memory access out of bounds", memory: false }), "engine", /out of bounds/],
    [(worker) => worker.answer({ fault: "out of memory", memory: true }), "out-of-memory", /out of memory/],
    [(worker) => worker.fail("no such file"), "engine", /no such file/],
  ]) {
    const { converter, workers } = begin();
    const failed = converter.convert();
    await turn();
    fail(workers[0]);
    await assert.rejects(failed, refuses(kind, message));
    assert.ok(workers[0].terminated);
    const again = converter.preview();
    workers[1].answer({ answer: { preview: {} }, archive: null });
    assert.deepEqual(await again, {});
  }
});

test("files and options that cannot be used are refused", async () => {
  assert.throws(() => begin(new File(["x"], "a.laz")), refuses("invalid", /list/));
  assert.throws(() => begin(null), refuses("invalid", /list/));
  assert.deepEqual(begin(new Set()).converter.files, []);
  for (const [file, message] of [
    [null, /null/],
    [undefined, /undefined/],
    ["scan.laz", /class File, found "scan\.laz"/],
  ]) {
    assert.throws(() => begin([new File(["x"], "a.laz"), file]), refuses("invalid", message));
  }
  await assert.rejects(begin().converter.preview({ pixel: () => 0.1 }), refuses("invalid", /worker/));
  const { converter } = begin();
  await assert.rejects(
    converter.convert({}, "progress"),
    (error) => error instanceof SlicewalkError && error.kind === "invalid" && /progress is a function/.test(error.message),
  );
});

test("an archive is named after the scan or model, not after a file beside it", () => {
  const files = ["house.mtl", "wall.ktx2", "roof.DDS", "house.prj", "room.obj", "b.obj"].map((name) => new File(["x"], name));
  const { converter, workers } = begin(files);
  converter.preview();
  const [{ name, inputs }] = workers[0].requests;
  assert.equal(name, "room.slices");
  assert.deepEqual(
    inputs.map(({ beside }) => beside),
    [true, true, true, true, false, false],
  );
  assert.deepEqual([mainOf(files).name, mainOf(files.slice(0, 2)).name, mainOf([])], ["room.obj", "house.mtl", undefined]);
});
