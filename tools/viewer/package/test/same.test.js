// Compares the shipped engine with its native answers bit for bit.

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { before, test } from "node:test";
import { openArchive } from "../dist/index.js";
import { ACTION_CODE, ACTION_LENGTH, readAction, STATE_LENGTH } from "../dist/messages.js";
import { engineModule, FileHost, folder, numbers, read } from "./local.js";

const scene = read("scene.slices");
const settings = numbers("settings.f64");
let module;
before(async () => {
  module = await engineModule();
});

/** What the engine wants done. */
function actions(engine, now) {
  const todo = engine.poll(now);
  const all = [];
  for (let at = 0; at < todo.length; at += ACTION_LENGTH) {
    const message = readAction(todo, at);
    all.push({ ...message, what: ACTION_CODE[message.action] });
  }
  return all;
}

function serve(engine, now, archive = scene) {
  for (;;) {
    const fetches = actions(engine, now).filter(({ what }) => what === "fetch");
    for (const { fetch, start, end } of fetches) engine.given(fetch, archive.slice(start, end), now);
    while (engine.decode(now));
    if (fetches.length === 0) return;
  }
}

/** An engine with the whole archive in memory. */
function whole() {
  const engine = module.open(scene.length, 1e9, 4);
  serve(engine, 0);
  const all = engine.load(Float64Array.of(-100, -100, -100, 100, 100, 100));
  serve(engine, 0);
  assert.equal(engine.outcome(all), 0);
  return engine;
}

/** State of a pawn after one row of inputs: a step or a place. */
function play(engine, pawn, row) {
  return row[5] === -1 ? engine.place(pawn, row.subarray(1, 4)) : engine.step(pawn, row[0], row.subarray(1));
}

/** Compares bits: NaN equals itself, and 0 differs from -0. */
function same(found, expected, what) {
  assert.equal(found.length, expected.length, what);
  const bits = (numbers) =>
    numbers instanceof Uint8Array ? numbers : new BigUint64Array(numbers.buffer, numbers.byteOffset, numbers.length);
  const [a, b] = [bits(found), bits(expected)];
  const first = a.findIndex((word, n) => word !== b[n]);
  assert.equal(first, -1, `${what}: number ${first} is ${found[first]}, natively ${expected[first]}`);
}

const questions = read("boxes.answers.u8").length;

test(`${questions} boxes, their floors, spheres, cylinders, sweeps and rays`, () => {
  const engine = whole();
  const boxes = numbers("boxes.f64");
  same(engine.overlaps(boxes), read("boxes.answers.u8"), "boxes");
  same(engine.floor(boxes), numbers("boxes.floors.f64"), "floors");
  same(engine.spheres(numbers("spheres.f64")), read("spheres.answers.u8"), "spheres");
  same(engine.cylinders(numbers("cylinders.f64")), read("cylinders.answers.u8"), "cylinders");
  same(engine.sweep(numbers("sweeps.f64")), numbers("sweeps.answers.f64"), "sweeps");
  same(engine.cast(numbers("rays.f64")), numbers("rays.answers.f64"), "rays");
  engine.free();
});

test("cylinders and spheres that slide, and a crowd that gathers", () => {
  const engine = whole();
  const [sweeps, cylinders, spheres] = ["sweeps.f64", "cylinders.f64", "spheres.f64"].map(numbers);
  const slides = [];
  for (let n = 0; n < Math.min(10_000, questions); n++) {
    const motion = sweeps.subarray(9 * n + 6, 9 * n + 9);
    slides.push(...engine.slide(cylinders.subarray(5 * n, 5 * n + 5), motion, 4));
    slides.push(...engine.slide(spheres.subarray(4 * n, 4 * n + 4), motion, 4));
  }
  same(Float64Array.from(slides), numbers("slides.f64"), "slides");
  const places = numbers("crowd.f64");
  const crowd = engine.crowd(settings.subarray(10, 20), places);
  const wishes = Float64Array.from(places, (_, n) => [2, -2, 1][n % 3]);
  const states = [];
  for (let frame = 0; frame < 600; frame++) states.push(...engine.step_crowd(crowd, 1 / 60, wishes));
  same(Float64Array.from(states), numbers("crowd.states.f64"), "crowd");
  engine.free();
});

test("rays beyond the pages in memory, by an overview level", () => {
  const levels = read("levels.slices");
  const engine = module.open(levels.length, 64e6, 4);
  serve(engine, 0, levels);
  const view = engine.scene(0.1, 1e5, 0.01, true, false);
  engine.look(view, Float64Array.of(0, 0, 1));
  serve(engine, 0, levels);
  engine.load(Float64Array.of(-3, -3, -1, 1, 1, 4));
  serve(engine, 0, levels);
  const found = engine.far(numbers("rays.f64"));
  same(found, numbers("rays.far.f64"), "far rays");
  const truth = numbers("rays.answers.f64");
  let [exact, bounds] = [0, 0];
  for (let ray = 0; 2 * ray < found.length; ray++) {
    const [distance, coarse, first] = [found[2 * ray], found[2 * ray + 1], truth[5 * ray]];
    if (coarse === 0) assert.equal(distance, first, `ray ${ray}`);
    else assert.ok(distance <= first, `ray ${ray}: free for ${distance} m, and there is matter at ${first} m`);
    coarse === 0 ? exact++ : bounds++;
  }
  assert.ok(exact > questions / 20 && bounds > questions / 20, `${exact} exact, ${bounds} bounds`);
  engine.free();
});

test("a box and a cylinder that a player moves for ten minutes", () => {
  const engine = whole();
  const [inputs, expected] = [numbers("inputs.f64"), numbers("inputs.states.f64")];
  const found = new Float64Array(expected.length);
  let at = 0;
  for (const body of [settings.subarray(0, 10), settings.subarray(10, 20)]) {
    const pawn = engine.pawn(body, Float64Array.of(-2, 2, 0.2));
    for (let row = 0; row < inputs.length; row += 6) {
      found.set(play(engine, pawn, inputs.subarray(row, row + 6)), at);
      at += STATE_LENGTH;
    }
  }
  same(found, expected, "states");
  const seen = (column) => new Set(found.filter((_, at) => at % STATE_LENGTH === column));
  assert.deepEqual([seen(3).size, seen(4).size >= 5], [4, true], "walks, falls, flies and is blocked, and for several reasons");
  engine.free();
});

test("a walk over a slow link asks for the same bytes at the same times", () => {
  const engine = module.open(scene.length, 64 << 20, 4);
  const [inputs, expected] = [numbers("inputs.f64"), numbers("streamed.f64")];
  const words = [];
  let [link, freeAt, now, pawn] = [[], 0, 0, undefined];
  for (let row = 0; row < 6 * 1800; row += 6) {
    const arrived = link.filter((answer) => answer.at <= now);
    link = link.filter((answer) => answer.at > now);
    for (const { name, start, end } of arrived) {
      engine.given(name, scene.slice(start, end), now);
      while (engine.decode(now));
    }
    if (engine.is_open()) {
      pawn ??= engine.pawn(settings.subarray(0, 10), Float64Array.of(-2, 2, 0.2));
      words.push(...play(engine, pawn, inputs.subarray(row, row + 6)));
    }
    for (const { what, fetch: name, start, end } of actions(engine, now)) {
      if (what === "fetch") {
        words.push(start, end);
        freeAt = Math.max(freeAt, now + 40) + (end - start) / 2500;
        link.push({ at: freeAt, name, start, end });
      } else if (what === "cancel") {
        link = link.filter((answer) => answer.name !== name);
      }
    }
    now += 1000 / 60;
  }
  same(Float64Array.from(words), expected, "streamed");
  engine.free();
});

test("what a walker records is walked natively to the last bit", async (t) => {
  const replay = process.env.SLICEWALK_REPLAY;
  if (!replay) {
    t.skip("SLICEWALK_REPLAY names no program");
    return;
  }
  const archive = await openArchive("http://host/scene.slices", { worker: new FileHost(scene).worker });
  const walker = await archive.walker({ at: [-2, 2, 0.2], maxDrop: 4 });
  await walker.step(0.01, {});
  await walker.record();
  const inputs = numbers("inputs.f64");
  // Pages arrive during the walk, so some ticks are postponed.
  for (let row = 0; row < 6 * 900; row += 6) {
    const [seconds, x, y, pace, lift, flags] = inputs.subarray(row, row + 6);
    if (flags === -1) {
      await walker.place([x, y, pace]);
      continue;
    }
    const way = flags & 8 ? { toward: [x, y] } : { wish: [x, y] };
    await walker.step(seconds, { ...way, pace, lift, jump: !!(flags & 1), crouch: !!(flags & 2), fly: !!(flags & 4) });
  }
  const recording = await walker.recording();
  archive.close();
  assert.ok(recording.path.length > 1000);
  const folder_ = mkdtempSync(join(tmpdir(), "slicewalk-"));
  try {
    const run = (changed) => {
      writeFileSync(join(folder_, "walk.json"), JSON.stringify(changed));
      return spawnSync(replay, [`${folder}/scene.slices`, join(folder_, "walk.json")], { encoding: "utf8" });
    };
    const sound = run(recording);
    assert.equal(sound.status, 0, sound.stderr);
    assert.match(sound.stdout, /the same path/);
    // The smallest difference is detected.
    const path = recording.path.slice();
    path[900] += Number.EPSILON * path[900];
    const other = run({ ...recording, path });
    assert.equal(other.status, 1);
    assert.match(other.stderr, /step 300/);
  } finally {
    rmSync(folder_, { recursive: true });
  }
});
