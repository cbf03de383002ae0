// The package as used by a page, on an archive that is read by ranges.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import {
  CLEAR,
  CROWD_ACTIVITIES,
  ERROR_KINDS,
  HIT,
  isSlicewalkError,
  NOT_LOADED,
  openArchive,
  SlicewalkError,
} from "../dist/index.js";
import { FileHost, gone, numbers, read, until } from "./local.js";

const scene = read("scene.slices");
const URL_ = "http://host/scene.slices";
const open = (host, options) => openArchive(URL_, { worker: host.worker, ...options });
const refuses =
  (kind, message = /./) =>
  (error) =>
    error instanceof SlicewalkError && error.kind === kind && message.test(error.message);

test("opens with three requests and says what the head says", async () => {
  const host = new FileHost(scene);
  const archive = await open(host);
  const { info } = archive;
  assert.equal(info.name, URL_);
  assert.equal(info.fileBytes, scene.length);
  assert.deepEqual([info.pixelSize, info.sliceHeight, info.origin, info.maxSlope], [0.04, 0.12, [0, 0, 0], 45]);
  assert.ok(info.pages >= 16 && info.formatVersion.startsWith("1."));
  assert.deepEqual(await archive.reference(), { crs: "", unit: { name: "unknown", factor: null } });
  assert.ok(host.asked.length <= 2, `${host.asked.length} requests: head, and all that lies at the end`);
  archive.close();
  await assert.rejects(archive.overlaps(new Float64Array(6)), refuses("aborted"));
});

test("answers batches as natively, once what they need is loaded, under a budget of part of the archive", async () => {
  const archive = await open(new FileHost(scene), { budgetBytes: 1_000_000 });
  // A ray needs more pages than a box, and only some of them fit at a time.
  const [rows, far] = [3000, 200];
  const boxes = numbers("boxes.f64").subarray(0, 6 * rows);
  const now = await archive.overlaps(boxes);
  assert.ok(now.includes(NOT_LOADED) && !now.includes(HIT), "nothing is in memory yet, and nothing is said to be free wrongly");
  const native = read("boxes.answers.u8").subarray(0, rows);
  assert.ok(now.every((answer, n) => answer === NOT_LOADED || answer === native[n]));
  assert.deepEqual(await archive.overlaps(boxes, { load: true }), native);
  assert.ok(native.includes(CLEAR) && native.includes(HIT));
  for (const [round, width, method] of [
    ["spheres", 4, "overlapsSpheres"],
    ["cylinders", 5, "overlapsCylinders"],
  ]) {
    const shapes = numbers(`${round}.f64`).subarray(0, width * rows);
    const expected = read(`${round}.answers.u8`).subarray(0, rows);
    assert.ok((await archive[method](shapes)).every((answer, n) => answer === NOT_LOADED || answer === expected[n]));
    assert.deepEqual(await archive[method](shapes, { load: true }), expected);
  }
  assert.deepEqual(await archive.floor(boxes, { load: true }), numbers("boxes.floors.f64").slice(0, rows));
  const sweeps = await archive.sweep(numbers("sweeps.f64").subarray(0, 9 * rows), { load: true });
  assert.deepEqual(sweeps, numbers("sweeps.answers.f64").slice(0, rows));
  const hits = await archive.castHits(numbers("rays.f64").subarray(0, 7 * far), { load: true });
  const expected = numbers("rays.answers.f64").subarray(0, 5 * far);
  assert.deepEqual(
    hits.distances,
    expected.filter((_, n) => n % 5 === 0),
  );
  assert.deepEqual(
    hits.normals,
    expected.filter((_, n) => n % 5 > 0 && n % 5 < 4),
  );
  assert.deepEqual(Array.from(hits.obstacles), Array.from(expected.filter((_, n) => n % 5 === 4)));
  await until(() => archive.stats.pending === 0 && archive.stats.evicted > 0);
  assert.ok(archive.stats.peakBytes <= 1_000_000 && archive.stats.requests >= 2 && archive.stats.bytesLoaded > 1000);
  archive.close();
});

test("errors are told apart by their kind", () => {
  const error = new SlicewalkError("network", "no answer");
  assert.ok(isSlicewalkError(error) && isSlicewalkError(error, "aborted", "network"));
  assert.ok(!isSlicewalkError(error, "aborted") && !isSlicewalkError(new Error("network")) && !isSlicewalkError(undefined));
  assert.ok(ERROR_KINDS.includes(error.kind) && new Set(ERROR_KINDS).size === 9);
});

test("arguments that make no sense are refused with their row", async () => {
  const archive = await open(new FileHost(scene));
  await assert.rejects(archive.overlaps(new Float64Array(7)), refuses("invalid", /7 numbers are not rows of 6/));
  const boxes = new Float64Array(6 * 5000);
  boxes[6 * 4500] = 1;
  await assert.rejects(archive.overlaps(boxes), refuses("invalid", /^row 4500: box/));
  await assert.rejects(archive.overlapsSpheres(new Float64Array(6)), refuses("invalid", /6 numbers are not rows of 4/));
  const spheres = new Float64Array(4 * 5000);
  spheres[4 * 4500 + 3] = -1;
  await assert.rejects(archive.overlapsSpheres(spheres), refuses("invalid", /^row 4500: sphere/));
  await assert.rejects(
    archive.overlapsCylinders(Float64Array.of(0, 0, 0, 1, Number.NaN)),
    refuses("invalid", /^row 0: cylinder/),
  );
  await assert.rejects(archive.cast(new Float64Array(7)), refuses("invalid", /row 0: ray/));
  await assert.rejects(archive.walker({ at: [0, 0, Number.NaN] }), refuses("invalid"));
  await assert.rejects(archive.walker({ at: [0, 0, 0], climb: 3 }), refuses("invalid", /climb/));
  await assert.rejects(archive.walker({ at: [0, 0, 1e10] }), refuses("invalid", /1e9 m/));
  const walker = await archive.walker({ at: [0, 0, 1] });
  await assert.rejects(walker.place([1e10, 0, 0]), refuses("invalid", /1e9 m/));
  assert.deepEqual(walker.state.at, [0, 0, 1]);
  await assert.rejects(archive.load({ min: [1, 0, 0], max: [0, 0, 0] }), refuses("invalid", /box/));
  assert.equal(archive.error, null);
  archive.close();
});

test("arguments of another type are refused, and the archive stays usable", async () => {
  const archive = await open(new FileHost(scene));
  const at = [0, 0, 1];
  const walker = await archive.walker({ at: Float64Array.from(at), body: undefined });
  const crowd = await archive.crowd({ at: Float64Array.from(at) });
  const callbacks = { onPage: () => undefined, onDrop: () => undefined };
  const view = archive.view(callbacks);
  const shape = { shape: "box", x: 0.5, y: 0.5, height: 1.8, at };
  for (const [call, message] of [
    [() => archive.overlaps([0, 0, 0, 1, 1, 1]), /Float64Array, found Array/],
    [() => archive.castHits(new Float32Array(7)), /Float64Array, found Float32Array/],
    [() => archive.floor(), /Float64Array/],
    [() => archive.overlaps(new Float64Array(6), { signal: new AbortController() }), /signal/],
    [() => archive.overlaps(gone()), /transferred/],
    [() => archive.load(), /box/],
    [() => archive.load({ min: at }), /corner/],
    [() => archive.map(), /area/],
    [() => archive.map({ min: [0, 0], max: [1, 1] }, 2), /heights/],
    [() => archive.map({ min: [0, 0], max: [1, 1] }, [0, 2], "many"), /cells/],
    [() => archive.map({ min: [0, 0], max: [1, 1] }, [0, 2], -1), /cells is a whole number from 1 up, found -1/],
    [() => archive.moveAndSlide(undefined, at), /shape/],
    [() => archive.moveAndSlide({ ...shape, shape: "capsule" }, at), /shape.*"capsule"/],
    [() => archive.moveAndSlide({ ...shape, x: undefined }, at), /shape\.x/],
    [() => archive.moveAndSlide(shape, "up"), /move/],
    [() => archive.moveAndSlide(shape, at, { iterations: Number.NaN }), /iterations/],
    [() => archive.moveAndSlide(shape, at, { iterations: 0 }), /iterations/],
    [() => archive.moveAndSlide(shape, at, { iterations: 1.5 }), /iterations/],
    [() => archive.walker(), /place/],
    [() => archive.walker({}), /place/],
    [() => archive.walker({ at: gone() }), /place/],
    [() => archive.walker({ at: ["0", "0", "1"] }), /place/],
    [() => archive.walker({ at, body: { shape: "capsule", radius: 1, height: 2 } }), /box or a cylinder.*"capsule"/],
    [() => archive.walker({ at, body: null }), /body/],
    [() => archive.walker({ at, body: { shape: "box", x: 1, y: 1 } }), /height/],
    [() => archive.walker({ at, speed: null }), /speed/],
    [() => archive.walker({ at, maxDrop: Number.NaN }), /maxDrop/],
    [() => walker.step(Number.NaN, {}), /seconds/],
    [() => walker.step(-1, {}), /seconds/],
    [() => walker.step(0.1, { wish: [1] }), /wish/],
    [() => walker.step(0.1, { wish: {} }), /wish/],
    [() => walker.step(0.1, { pace: "fast" }), /pace/],
    [() => walker.place(), /place/],
    [() => walker.set({ climb: "high" }), /climb/],
    [() => walker.route(), /place/],
    [() => archive.crowd({ at: [0, 0, 1] }), /Float64Array/],
    [() => crowd.step(0.1, [0, 0, 0]), /Float64Array/],
    [() => crowd.step(Number.NaN, new Float64Array(3)), /seconds/],
    [() => openArchive(undefined, { worker: new FileHost(scene).worker }), /address/],
    [() => open(new FileHost(scene), { budgetBytes: "all" }), /budgetBytes/],
    [() => open(new FileHost(scene), { requests: 0.5 }), /requests/],
    // Not asynchronous.
    [async () => archive.view({ onPage: () => undefined }), /onDrop/],
    [async () => archive.view({ ...callbacks, radius: Number.NaN }), /radius/],
    [async () => view.set({ detail: "fine" }), /detail/],
    [async () => view.look([0, Number.NaN, 1]), /camera is three finite numbers, found \[0, NaN, 1\]/],
    [async () => view.look([0, 0]), /camera/],
    [async () => view.look(gone()), /camera/],
    [async () => archive.on("progress", () => undefined), /stats, trouble, failed/],
    [async () => archive.on("stats"), /listener/],
  ]) {
    // A call that throws at once instead of rejecting fails the test.
    await assert.rejects(call(), refuses("invalid", message), `${call}`);
  }
  // What may be left out, and lists of every kind.
  assert.equal((await walker.step(0.1)).steps, 1);
  assert.equal((await walker.step(0.1, { toward: at })).steps, 2);
  assert.deepEqual((await walker.place(new Float32Array(3))).at, [0, 0, 0]);
  await archive.load({ min: Float64Array.of(0, 0, 0), max: at }, null);
  view.look(Float64Array.from(at));
  await archive.reference();
  assert.equal(archive.error, null);
  archive.close();
});

test("a batch that fails leaves no pages for the next one to load", async () => {
  const boxes = numbers("boxes.f64").slice(0, 6 * 1000);
  boxes[6 * 999] = Number.NaN;
  const bytesAsked = async (fails) => {
    const host = new FileHost(scene);
    const archive = await open(host);
    const before = host.asked.length;
    if (fails) await assert.rejects(archive.overlaps(boxes, { load: true }), refuses("invalid", /^row 999: box/));
    await archive.overlaps(Float64Array.of(-1, -1, -0.5, 1, 1, 0.5), { load: true });
    archive.close();
    return host.asked.slice(before).reduce((bytes, [start, end]) => bytes + end - start, 0);
  };
  assert.equal(await bytesAsked(true), await bytesAsked(false));
});

test("a closed archive says nothing more, whatever its worker had sent", async () => {
  const worker = new FileHost(scene).worker();
  const archive = await openArchive(URL_, { worker: () => worker });
  const told = [];
  archive.on("stats", (stats) => told.push(stats));
  archive.on("trouble", (error) => told.push(error));
  archive.close();
  worker.onmessage({ data: { event: "stats", stats: archive.stats } });
  worker.onmessage({ data: { event: "trouble", fault: null } });
  assert.deepEqual(told, []);
});

test("a shape slides along what it meets, and waits for nothing that it was not told to load", async () => {
  const archive = await open(new FileHost(scene));
  const body = { shape: "box", x: 0.5, y: 0.5, height: 1.8, at: [-6, 2, 1.5] };
  const motion = [0, 0.3, -3];
  assert.deepEqual(await archive.moveAndSlide(body, motion), { motion: [0, 0, 0], contacts: [], missing: true });
  const down = await archive.moveAndSlide(body, motion, { load: true });
  assert.ok(!down.missing && down.contacts.length > 0 && down.motion[2] > -1.51 && down.motion[2] < -0.9, JSON.stringify(down));
  const [{ normal, distance, obstacle }] = down.contacts;
  assert.deepEqual([normal, obstacle], [[0, 0, 1], false]);
  assert.ok(distance > 0.9 && distance <= Math.hypot(...motion));
  // The same box by its corners, and no more contacts than asked for.
  const bounds = { min: [-6.25, 1.75, 1.5], max: [-5.75, 2.25, 3.3] };
  assert.deepEqual(await archive.moveAndSlide(bounds, motion), down);
  const once = await archive.moveAndSlide(bounds, motion, { iterations: 1 });
  assert.ok(once.contacts.length === 1 && once.motion[1] < down.motion[1]);
  for (const iterations of [16, 2 ** 32, Infinity]) {
    assert.deepEqual(await archive.moveAndSlide(bounds, motion, { iterations }), down);
  }
  // Into the outer wall, whose surface lies at 8.8, along it and into the corner.
  const sphere = { shape: "sphere", radius: 0.2, at: [8.5, 8, 1.5] };
  const corner = await archive.moveAndSlide(sphere, [5, 4, 0], { load: true });
  assert.ok(
    corner.motion.every((v, axis) => Math.abs(v - [0.1, 0.6, 0][axis]) < 0.05),
    `${corner.motion}`,
  );
  const free = await archive.moveAndSlide({ shape: "cylinder", radius: 0.2, height: 1, at: sphere.at }, [0.01, 0.02, 0]);
  assert.deepEqual(free, { motion: [0.01, 0.02, 0], contacts: [], missing: false });
  await assert.rejects(archive.moveAndSlide(bounds, [0, Number.NaN, 0]), refuses("invalid", /move/));
  await assert.rejects(archive.moveAndSlide({ min: [0, 0, 0], max: [1, 1] }, [0, 0, 0]), refuses("invalid", /box/));
  const late = new AbortController();
  const far = archive.moveAndSlide(bounds, [15, 15, 0], { load: true, signal: late.signal });
  late.abort();
  await assert.rejects(far, refuses("aborted"));
  archive.close();
  const small = await open(new FileHost(scene), { budgetBytes: 300_000 });
  const up = { min: [-8, -8, 5.5], max: [-7.9, -7.9, 5.6] };
  const all = { min: [-8, -8, -0.05], max: [8.7, 8.7, 5.2] };
  assert.ok((await small.moveAndSlide(up, [0, 0, 1])).contacts.length === 0);
  await assert.rejects(small.moveAndSlide(all, [0, 0, 20], { load: true }), refuses("out-of-memory", /move/));
  small.close();
});

test("a walker waits for its pages and then walks, jumps, crouches and flies", async () => {
  const host = new FileHost(scene);
  const archive = await open(host);
  host.delay = 200;
  const at = [-2, 2, 0.2];
  const walker = await archive.walker({ at });
  assert.deepEqual(walker.state.at, at);
  const first = await walker.step(1 / 60, {});
  assert.ok(first.missing > 0 && first.ticks === 0, "not loaded is never free");
  host.delay = 1;
  await archive.load({ min: [-4, 0, -1], max: [1, 4, 5] });
  const go = async (frames, input) => {
    let highest = -Infinity;
    for (let n = 0; n < frames; n++) {
      highest = Math.max(highest, (await walker.step(1 / 60, input)).at[2]);
    }
    return highest;
  };
  await go(60, {});
  assert.equal(walker.state.ground, "walking");
  const [x, , z] = walker.state.at;
  assert.ok((await go(20, { jump: true })) > z + 0.3);
  await go(60, {});
  await go(12, { wish: [1, 0], pace: 0.5 });
  assert.ok(walker.state.at[0] > x + 0.05, `${walker.state.at}, from ${x}`);
  await go(2, { crouch: true });
  assert.deepEqual([walker.state.crouched, walker.state.height], [true, 1.8 * 0.6]);
  await go(2, {});
  assert.equal(walker.state.crouched, false);
  await go(60, { fly: true, lift: 1 });
  assert.equal(walker.state.ground, "flying");
  assert.ok(walker.state.at[2] > z + 1 && walker.state.rise > 1);
  assert.equal((await walker.place(at)).at[2], 0.2);
  await go(1, {});
  await assert.rejects(walker.set({ body: { shape: "cylinder", radius: 1.5, height: 3 } }), refuses("invalid", /room/));
  await walker.set({ speed: 3, body: { shape: "cylinder", radius: 0.1, height: 0.9 } });
  assert.equal((await walker.step(0.1, {})).height, 0.9);
  // Those that are set before the answers come, beside some that are refused.
  await Promise.all([
    assert.rejects(walker.set({ climb: 3 }), refuses("invalid", /climb/)),
    walker.set({ speed: 2 }),
    walker.set({ gravity: 5 }),
  ]);
  const { speed } = await walker.step(0.2, { fly: true, wish: [1, 0] });
  assert.ok(Math.abs(speed - 2) < 1e-9, `${speed} m/s`);
  const { options } = await walker.recording();
  assert.deepEqual([options.climb, options.speed, options.gravity], [0.35, 2, 5]);
  walker.close();
  await assert.rejects(walker.step(0.1, {}), refuses("invalid", /closed/));
  archive.close();
});

test("a walker finds its way up the stairs, walks it, and says why there is none", async () => {
  const archive = await open(new FileHost(scene), { budgetBytes: 16_000_000 });
  const walker = await archive.walker({ at: [-6, 1.5, 0.2] });
  await archive.load({ min: [-7, 1, -1], max: [-5, 2, 5] });
  const go = (input) => walker.step(1 / 60, input);
  for (let n = 0; n < 60; n++) await go({});
  await walker.record();
  const to = [4, 4, 3];
  const route = await walker.route(to);
  assert.ok(typeof route === "object" && route.points.length > 2, JSON.stringify(route));
  const straight = Math.hypot(10, 2.5, 3);
  assert.ok(route.length > straight && route.length < 2.5 * straight, `${route.length} m`);
  const end = route.points.at(-1);
  assert.ok(Math.hypot(...end.map((v, axis) => v - to[axis])) < 0.5, `${end}`);
  let most = 0;
  const follow = async () => {
    for (let n = 0; n < 60 * 60; n++) {
      const { ahead, ground } = await go({ follow: true, pace: 2 });
      most = Math.max(most, ahead);
      if (ahead === 0 && ground === "walking") return;
    }
  };
  await follow();
  const { at } = walker.state;
  assert.ok(
    most > 1 && Math.hypot(at[0] - end[0], at[1] - end[1]) < 1e-3 && Math.abs(at[2] - 3) < 0.02,
    `${at}, beside ${end}`,
  );
  // Nothing is left to follow.
  await go({ follow: true });
  assert.deepEqual(walker.state.at, at);
  // A row for each place on the way: one leg after the other.
  const { steps } = await walker.recording();
  const places = new Set();
  for (let row = 0; row < steps.length; row += 8) if (steps[row + 5] & 8) places.add(`${steps[row + 1]} ${steps[row + 2]}`);
  assert.ok(places.size >= route.points.length - 1, `${places.size} of ${route.points.length}`);
  // Back over the edge of the gallery it does not go: down the stairs.
  const back = await walker.route([4, -4, 0.1]);
  assert.ok(typeof back === "object" && back.length > 10, JSON.stringify(back));
  // What is straight ahead needs no plan; a place beside the wall is moved.
  const near = await walker.route([at[0], at[1] + 0.1, at[2]]);
  assert.equal(near.points.length, 2);
  const beside = await walker.route([at[0], 8.7, 3]);
  assert.ok(beside.points.at(-1)[1] < 8.6 && beside.points.at(-1)[1] > 8.2, JSON.stringify(beside.points.at(-1)));
  assert.equal(await walker.route([40, 0, 0]), "not-standing-to");
  const gate = new AbortController();
  const late = walker.route([-6, -6, 0], { signal: gate.signal });
  gate.abort();
  await assert.rejects(late, refuses("aborted"));
  await assert.rejects(walker.route([0, 0, Number.NaN]), refuses("invalid", /place/));
  walker.close();
  archive.close();
});

test("walkers of a crowd wait for pages, keep out of each other and settle around their goal", async () => {
  const host = new FileHost(scene);
  const archive = await open(host);
  host.delay = 200;
  const body = { shape: "cylinder", radius: 0.2, height: 1.7 };
  const places = Float64Array.from(
    { length: 36 },
    (_, n) => [-6 + 0.6 * (Math.floor(n / 3) % 4), -6 + 0.6 * Math.floor(n / 12), 0.6][n % 3],
  );
  const crowd = await archive.crowd({ at: places, body });
  assert.deepEqual(crowd.state, { places, activities: new Uint8Array(12), missing: 0 });
  const goals = Float64Array.from({ length: 36 }, (_, n) => [-4, -4.9, 1][n % 3]);
  const first = await crowd.step(1 / 60, goals);
  assert.ok(first.missing > 0, "not loaded is never free");
  assert.deepEqual(first.places, places);
  host.delay = 1;
  await archive.load({ min: [-7, -7, -1], max: [-2, -2, 3] });
  let frames = 0;
  const done = () => crowd.state.activities.every((activity) => CROWD_ACTIVITIES[activity] === "arrived");
  while (!done() && frames++ < 3600) await crowd.step(1 / 60, goals);
  assert.ok(done(), `${crowd.state.activities}`);
  const end = crowd.state.places;
  for (let n = 0; n < 12; n++) {
    assert.ok(Math.hypot(end[3 * n] + 4, end[3 * n + 1] + 4.9) < 2, `${end.subarray(3 * n, 3 * n + 3)}`);
    for (let m = 0; m < n; m++) {
      assert.ok(Math.hypot(end[3 * n] - end[3 * m], end[3 * n + 1] - end[3 * m + 1]) > 0.4 - 1e-6, `${n} in ${m}`);
    }
  }
  await assert.rejects(crowd.step(1 / 60, goals.subarray(3)), refuses("invalid", /33 numbers are not wishes of 12 walkers/));
  const wrong = goals.slice();
  wrong[16] = Number.NaN;
  await assert.rejects(crowd.step(1 / 60, wrong), refuses("invalid", /^row 5: a wish/));
  await assert.rejects(archive.crowd({ at: new Float64Array(0) }), refuses("invalid", /places/));
  await assert.rejects(archive.crowd({ at: new Float64Array(3003) }), refuses("invalid", /places/));
  await assert.rejects(archive.crowd({ at: new Float64Array(4) }), refuses("invalid", /places/));
  await assert.rejects(archive.crowd({ at: Float64Array.of(0, 0, Number.NaN) }), refuses("invalid"));
  await assert.rejects(archive.crowd({ at: places, climb: 3 }), refuses("invalid", /climb/));
  crowd.close();
  await assert.rejects(crowd.step(1 / 60, goals), refuses("invalid", /closed/));
  archive.close();
});

test("a view gets the pages around its camera, and forgets those it leaves behind", async () => {
  const archive = await open(new FileHost(scene));
  const pages = new Map();
  const dropped = [];
  const view = archive.view({ radius: 2, onPage: (page) => pages.set(page.id, page), onDrop: (id) => dropped.push(id) });
  view.look([0, 0, 1]);
  await until(() => pages.size > 3 && archive.stats.unbuilt === 0 && archive.stats.pending === 0);
  for (const page of pages.values()) {
    assert.equal(page.positions.length % 12, 0);
    assert.deepEqual(
      [page.normals.length, page.attributes.length],
      [(page.positions.length / 3) * 4, (page.positions.length / 3) * 4],
    );
    assert.equal(page.indices.length, page.positions.length / 2);
    assert.equal(Math.max(...page.indices.subarray(-6)), page.positions.length / 3 - 1);
    assert.deepEqual([page.origin[0], page.key.level], [page.key.tx * 64 * 0.04, 0]);
    for (let vertex = 0; vertex < page.positions.length; vertex += 3) {
      for (const axis of [0, 1, 2]) {
        const at = page.origin[axis] + page.scale[axis] * page.positions[vertex + axis];
        const slack = page.cell + 1e-9;
        assert.ok(at >= page.bounds.min[axis] - slack && at <= page.bounds.max[axis] + slack, `${at} along ${axis}`);
      }
    }
  }
  const near = [...pages.keys()];
  view.look([500, 0, 1]);
  await until(() => dropped.length === near.length);
  assert.deepEqual(
    dropped.sort((a, b) => a - b),
    near.sort((a, b) => a - b),
  );
  view.close();
  archive.close();
});

test("a map shows floor, obstacles and what is not loaded", async () => {
  const archive = await open(new FileHost(scene));
  const area = { min: [-2, -2], max: [2, 2] };
  const before = await archive.map(area, [0.1, 2], 64);
  assert.deepEqual([before.width, before.height, before.cells.length], [64, 64, 4096]);
  assert.ok(before.cells.every((cell) => cell === 0 || cell === 3) && before.cells.includes(3));
  await archive.load({ min: [-2, -2, -1], max: [2, 2, 3] });
  const after = await archive.map(area, [-0.1, 2], 64);
  assert.ok(after.cells.includes(1) && after.cells.includes(2) && !after.cells.includes(3));
  archive.close();
});

test("a Blob is read by slices", async () => {
  const archive = await openArchive(new Blob([scene]), { worker: new FileHost(new Uint8Array()).worker });
  const boxes = numbers("boxes.f64").subarray(0, 600);
  assert.deepEqual(await archive.overlaps(boxes, { load: true }), read("boxes.answers.u8").subarray(0, 100));
  archive.close();
});

test("what is no archive, is damaged or needs more memory is said so", async () => {
  const text = new TextEncoder().encode("<!doctype html>".repeat(100));
  await assert.rejects(open(new FileHost(text)), refuses("not-an-archive", /rule H1/));
  await assert.rejects(open(new FileHost(scene.slice(0, 30_000))), refuses("damaged", /rule/));
  await assert.rejects(openArchive(new Blob([]), { worker: new FileHost(text).worker }), refuses("not-an-archive"));
  await assert.rejects(open(new FileHost(scene), { budgetBytes: 1000 }), refuses("out-of-memory", /table/));
  const small = await open(new FileHost(scene), { budgetBytes: 300_000 });
  const all = { min: [-9, -9, -9], max: [9, 9, 9] };
  await assert.rejects(small.load(all), refuses("out-of-memory", /no room for \d+ pages/));
  small.close();
  const bad = scene.slice();
  bad.fill(0x55, 17_000, 22_000);
  const archive = await open(new FileHost(bad));
  await assert.rejects(archive.load(all), refuses("damaged", /page/));
  const answers = await archive.overlaps(Float64Array.of(-9, -9, -9, 9, 9, 9));
  assert.ok(answers[0] === NOT_LOADED || answers[0] === HIT);
  archive.close();
});

/** CRC32C of bytes. */
function crc32c(bytes) {
  let crc = -1;
  for (const byte of bytes) {
    crc ^= byte;
    for (let bit = 0; bit < 8; bit++) crc = (crc >>> 1) ^ (crc & 1 ? 0x82f63b78 : 0);
  }
  return ~crc >>> 0;
}

test("an archive with a coding or another feature that the engine does not know is refused, not misread", async () => {
  for (const feature of [1, 40]) {
    const bytes = scene.slice();
    const head = new DataView(bytes.buffer, bytes.byteOffset);
    head.setBigUint64(16, head.getBigUint64(16, true) | (1n << BigInt(feature)), true);
    const end = head.getUint32(12, true) - 4;
    head.setUint32(end, crc32c(bytes.subarray(0, end)), true);
    const said = new RegExp(`required archive feature ${feature} \\(rule H5\\).*newer version`);
    await assert.rejects(open(new FileHost(bytes)), refuses("not-an-archive", said));
  }
});

test("an archive of an unreleased version is refused, and the way out is named", async () => {
  const bytes = scene.slice();
  bytes.set([0x89, 0x53, 0x4c, 0x49, 0x43, 0x0d, 0x0a, 0x1a]);
  await assert.rejects(open(new FileHost(bytes)), refuses("not-an-archive", /unreleased version.*convert the scan again/));
});

test("a host that goes away and comes back is waited for, and the trouble is told", async () => {
  const host = new FileHost(scene);
  const archive = await open(host);
  const told = [];
  archive.on("trouble", (error) => told.push(error?.kind ?? null));
  host.down = true;
  const loading = archive.load({ min: [-1, -1, 0], max: [1, 1, 2] });
  await until(() => told.includes("network"));
  host.down = false;
  await loading;
  await until(() => told.at(-1) === null);
  assert.equal(archive.error, null);
  archive.close();
});

test("the bytes of an archive are those that were opened, or none", async () => {
  const host = new FileHost(scene);
  const archive = await open(host);
  const bytes = async (opened) => new Uint8Array(await (await opened.file()).arrayBuffer());
  assert.deepEqual(await bytes(archive), scene);
  const gate = new AbortController();
  const late = archive.file({ signal: gate.signal });
  gate.abort();
  await assert.rejects(late, refuses("aborted"));
  host.down = true;
  await assert.rejects(archive.file(), refuses("network", /cannot be reached/));
  host.down = false;
  // Another tag, or another length.
  const { file, etag } = host;
  for (const [other, tag] of [
    [file, '"2"'],
    [file.slice(0, -1), etag],
  ]) {
    Object.assign(host, { file: other, etag: tag });
    await assert.rejects(archive.file(), refuses("replaced", /open it again/));
  }
  archive.close();
  await assert.rejects(archive.file(), refuses("aborted"));
  const local = await openArchive(new Blob([scene]), { worker: host.worker });
  assert.deepEqual(await bytes(local), scene);
  local.close();
});

test("an archive that is replaced meanwhile fails as a whole, once", async () => {
  const host = new FileHost(scene);
  const archive = await open(host);
  const failures = [];
  archive.on("failed", (error) => failures.push(error));
  host.etag = '"2"';
  await assert.rejects(archive.load({ min: [-1, -1, 0], max: [1, 1, 2] }), refuses("replaced", /open it again/));
  await assert.rejects(archive.overlaps(new Float64Array(6)), refuses("replaced"));
  assert.deepEqual([failures.map((error) => error.kind), archive.error?.kind], [["replaced"], "replaced"]);
});

test("opening and batches can be given up", async () => {
  const gate = new AbortController();
  const host = new FileHost(scene);
  const opening = open(host, { signal: gate.signal });
  gate.abort();
  await assert.rejects(opening, refuses("aborted"));
  await assert.rejects(open(host, { signal: gate.signal }), refuses("aborted"));
  const archive = await open(host);
  const again = new AbortController();
  const batch = archive.overlaps(numbers("boxes.f64"), { load: true, signal: again.signal });
  setTimeout(() => again.abort(), 5);
  await assert.rejects(batch, refuses("aborted"));
  assert.equal((await archive.overlaps(Float64Array.of(50, 50, 50, 51, 51, 51)))[0], CLEAR);
  archive.close();
});
