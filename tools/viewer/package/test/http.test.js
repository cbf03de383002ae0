// The fetch driver against a host that fails in every way, on a simulated clock.

import assert from "node:assert/strict";
import { test } from "node:test";
import { HttpSource, WHOLE_LIMIT } from "../dist/http.js";

const FILE = Uint8Array.from({ length: 1000 }, (_, n) => n % 251);
const URL_ = "http://host/a.slices";

/** A clock that advances while all readers wait; records the pauses of reads (not of watches). */
class Clock {
  time = 0;
  pauses = [];
  #sleepers = [];

  sleep(ms, signal) {
    return new Promise((resolve, reject) => {
      if (signal.aborted) {
        reject(new Error("aborted"));
        return;
      }
      const abort = () => {
        this.#sleepers = this.#sleepers.filter((other) => other !== sleeper);
        reject(new Error("aborted"));
      };
      const done = () => {
        signal.removeEventListener("abort", abort);
        resolve();
      };
      const sleeper = { at: this.time + ms, ms, resolve: done };
      this.#sleepers.push(sleeper);
      signal.addEventListener("abort", abort);
    });
  }

  /** Resumes the sleeper with the earliest time. */
  tick() {
    this.#sleepers.sort((a, b) => a.at - b.at);
    const next = this.#sleepers.shift();
    if (next) {
      this.time = Math.max(this.time, next.at);
      this.pauses.push(next.ms);
      next.resolve();
    }
  }

  /** Waits for a promise; time passes while nothing else happens. */
  async wait(promise) {
    let done = false;
    const end = () => {
      done = true;
    };
    promise.then(end, end);
    for (let turn = 0; !done; turn++) {
      assert.ok(turn < 10_000, "it never ends");
      for (let n = 0; n < 50 && !done; n++) {
        await Promise.resolve();
      }
      await new Promise((resolve) => setImmediate(resolve));
      if (!done) {
        this.tick();
      }
    }
    return promise;
  }
}

function answer(start, end, { etag = '"1"', modified, total = FILE.length, expose = true, body, status = 206 } = {}) {
  const headers = new Headers();
  if (etag) headers.set("ETag", etag);
  if (modified) headers.set("Last-Modified", modified);
  const last = Math.min(end, FILE.length);
  if (expose && status === 206) headers.set("Content-Range", `bytes ${start}-${last - 1}/${total}`);
  return new Response(body ?? FILE.slice(start, last), { status, headers });
}

/** A source whose host answers with `replies` in turn, and repeats the last one. */
function source(replies, options) {
  const clock = new Clock();
  const asked = [];
  const fetch = async (url, init) => {
    assert.equal(url, URL_);
    const [, start, end] = /^bytes=(\d+)-(\d+)$/.exec(init.headers.Range);
    assert.deepEqual(Object.keys(init.headers), ["Range"], "nothing that needs a preflight");
    const reply = replies[Math.min(asked.length, replies.length - 1)];
    asked.push([Number(start), Number(end) + 1]);
    return reply(Number(start), Number(end) + 1, init.signal);
  };
  const outside = { fetch, now: () => clock.time, sleep: (ms, signal) => clock.sleep(ms, signal) };
  return { source: new HttpSource(URL_, outside, options), clock, asked };
}

const fine = (start, end) => answer(start, end);
const never = new AbortController().signal;
const refuses = (kind, message) => (error) =>
  error.name === "SlicewalkError" && error.kind === kind && message.test(error.message);

test("reads ranges and learns the length", async () => {
  const { source: s, clock, asked } = source([fine]);
  assert.deepEqual(await clock.wait(s.read(0, 100, never)), FILE.slice(0, 100));
  assert.equal(s.length, 1000);
  assert.deepEqual(await clock.wait(s.read(990, 1000, never)), FILE.slice(990));
  assert.deepEqual([asked.length, s.requests, s.bytes], [2, 2, 110]);
});

test("a host of another origin that exposes nothing still serves, the first answer may be short", async () => {
  const { source: s, clock } = source([(start, end) => answer(start, end, { expose: false, etag: null })]);
  assert.equal((await clock.wait(s.read(0, 4096, never))).length, 1000);
  assert.equal(s.length, undefined);
});

test("failures that pass are tried again after pauses that grow, and then given up", async () => {
  const down = () => Promise.reject(new TypeError("fetch failed"));
  const {
    source: s,
    clock,
    asked,
  } = source([down, (a, b) => answer(a, b, { status: 503, body: "" }), () => answer(0, 0, { status: 429, body: "" }), fine]);
  assert.equal((await clock.wait(s.read(0, 10, never))).length, 10);
  assert.deepEqual([asked.length, clock.pauses], [4, [250, 500, 1000]]);
  const gone = source([down]);
  await assert.rejects(gone.clock.wait(gone.source.read(0, 10, never)), refuses("network", /cannot be reached.*CORS/));
  assert.equal(gone.asked.length, 4);
});

test("what the host refuses for good is not asked for again", async () => {
  for (const status of [400, 401, 403, 404, 410]) {
    const { source: s, clock, asked } = source([(a, b) => answer(a, b, { status, body: "no" })]);
    await assert.rejects(clock.wait(s.read(0, 10, never)), refuses("network", new RegExp(`answers ${status}`)));
    assert.equal(asked.length, 1);
  }
  const empty = source([(a, b) => answer(a, b, { status: 416, body: "" })]);
  await assert.rejects(empty.clock.wait(empty.source.read(0, 10, never)), refuses("not-an-archive", /empty/));
});

test("once open, it goes on trying for as long as somebody wants the bytes, and says so", async () => {
  const told = [];
  let up = true;
  const {
    source: s,
    clock,
    asked,
  } = source([(a, b) => (up ? answer(a, b) : answer(a, b, { status: 404, body: "" }))], {
    onTrouble: (error) => told.push(error?.kind ?? null),
  });
  await clock.wait(s.read(0, 10, never));
  up = false;
  const reading = s.read(10, 20, never);
  for (let n = 0; n < 12; n++) {
    for (let turn = 0; turn < 5; turn++) {
      await new Promise((resolve) => setImmediate(resolve));
    }
    clock.tick();
  }
  up = true;
  assert.deepEqual(await clock.wait(reading), FILE.slice(10, 20));
  assert.ok(asked.length > 10 && told.at(-1) === null && told[0] === "network", told.join());
  assert.equal(Math.max(...clock.pauses.filter((ms) => ms < 20_000)), 5000, "pauses end growing");
});

test("an archive that was replaced is an error, never a mix", async () => {
  const cases = [
    [{ etag: '"1"' }, { etag: '"2"' }],
    [
      { etag: null, modified: "Mon, 01 Jan 2024 00:00:00 GMT" },
      { etag: null, modified: "Tue, 02 Jan 2024 00:00:00 GMT" },
    ],
    [{ etag: null }, { etag: null, total: 2000 }],
    [{ etag: '"1"' }, { status: 416, body: "" }],
  ];
  for (const [first, then] of cases) {
    const { source: s, clock, asked } = source([(a, b) => answer(a, b, first), (a, b) => answer(a, b, then)]);
    await clock.wait(s.read(0, 10, never));
    await assert.rejects(clock.wait(s.read(10, 20, never)), refuses("replaced", /replaced.*open it again/));
    assert.equal(asked.length, 2);
  }
  // An ETag takes precedence: a copy with another date is the same file.
  const dates = ["Mon, 01 Jan 2024 00:00:00 GMT", "Tue, 02 Jan 2024 00:00:00 GMT"];
  let n = 0;
  const same = source([(a, b) => answer(a, b, { modified: dates[n++ % 2] })]);
  await same.clock.wait(same.source.read(0, 10, never));
  assert.equal((await same.clock.wait(same.source.read(10, 20, never))).length, 10);
});

test("a host without ranges: a small file is read whole, once; a large one is refused", async () => {
  const { source: s, clock, asked } = source([() => answer(0, 1000, { status: 200 })]);
  assert.deepEqual(await clock.wait(s.read(0, 100, never)), FILE.slice(0, 100));
  assert.deepEqual(await clock.wait(s.read(500, 700, never)), FILE.slice(500, 700));
  assert.deepEqual([asked.length, s.length], [1, 1000]);
  const large = () => new Response(FILE, { status: 200, headers: { "Content-Length": String(WHOLE_LIMIT + 1) } });
  const refused = source([large]);
  await assert.rejects(refused.clock.wait(refused.source.read(0, 100, never)), refuses("no-ranges", /ignores ranges.*64 MiB/));
  // A host that does not state the length.
  let pulled = 0;
  const chunk = new Uint8Array(8 << 20);
  const endless = () =>
    new Response(
      new ReadableStream({
        pull: (c) => {
          pulled += 1;
          c.enqueue(chunk);
        },
      }),
      { status: 200 },
    );
  const stopped = source([endless]);
  await assert.rejects(stopped.clock.wait(stopped.source.read(0, 100, never)), refuses("no-ranges", /ignores ranges/));
  assert.ok(pulled < 16, `${pulled} pieces of 8 MiB`);
});

test("answers that are short, long or of other bytes are asked for again", async () => {
  const wrong = [
    (a, b) => answer(a, b, { body: FILE.slice(a, a + 3) }),
    (a, b) => answer(a, b, { body: FILE.slice(a, b + 3) }),
    (a, b) => {
      const r = answer(a + 1, b + 1);
      return r;
    },
    (a, b) =>
      new Response(new ReadableStream({ pull: (c) => c.error(new Error("reset")) }), {
        status: 206,
        headers: answer(a, b).headers,
      }),
  ];
  for (const reply of wrong) {
    const { source: s, clock, asked } = source([fine, reply, fine]);
    await clock.wait(s.read(0, 10, never));
    assert.deepEqual(await clock.wait(s.read(10, 20, never)), FILE.slice(10, 20));
    assert.equal(asked.length, 3);
  }
});

test("a request that stalls is given up and made again", async () => {
  let given = 0;
  const stalls = (_a, _b, signal) =>
    new Promise((_, reject) =>
      signal.addEventListener("abort", () => {
        given += 1;
        reject(new DOMException("", "AbortError"));
      }),
    );
  const { source: s, clock, asked } = source([stalls, fine]);
  assert.equal((await clock.wait(s.read(0, 10, never))).length, 10);
  assert.deepEqual([asked.length, given, clock.pauses], [2, 1, [20_000, 250]]);
});

test("who gives up gets his answer at once, and the request ends", async () => {
  const gate = new AbortController();
  let ended = false;
  const hangs = (_a, _b, signal) =>
    new Promise((_, reject) =>
      signal.addEventListener("abort", () => {
        ended = true;
        reject(new DOMException("", "AbortError"));
      }),
    );
  const { source: s, asked } = source([hangs]);
  const reading = s.read(0, 10, gate.signal);
  await new Promise((resolve) => setImmediate(resolve));
  gate.abort();
  await assert.rejects(reading, refuses("aborted", /given up/));
  assert.ok(ended && asked.length === 1);
  await assert.rejects(s.read(0, 10, gate.signal), refuses("aborted", /given up/));
  assert.equal(asked.length, 1);
});
