/** Walkers as seen by the page. */

import type { Link } from "./link.js";
import type { Recorded, Step } from "./protocol.js";
import {
  type Body,
  type Ground,
  SlicewalkError,
  type Stop,
  type Vec3,
  type Walker,
  type WalkerInput,
  type WalkerOptions,
  type WalkerRecording,
  type WalkerSettings,
  type WalkerState,
} from "./types.js";

const GROUNDS: readonly Ground[] = ["walking", "falling", "blocked", "flying"];
const STOPS: readonly (Stop | null)[] = [null, "wall", "steep", "headroom", "corner", "inside", "ledge", "void"];

type Settings = Required<WalkerSettings>;

const DEFAULTS: Omit<Settings, "crouchHeight"> = {
  body: { shape: "box", x: 0.5, y: 0.5, height: 1.8 },
  climb: 0.35,
  speed: 1.4,
  gravity: 9.81,
  jump: 0.5,
  maxDrop: null,
};

/** Fills in defaults; the default crouching height depends on the body. */
function complete(given: WalkerSettings): Settings {
  const chosen = { ...DEFAULTS, ...defined(given) };
  const crouchHeight =
    given.crouchHeight ?? Math.min(chosen.body.height, Math.max(0.6 * chosen.body.height, chosen.climb + 0.1));
  return { ...chosen, crouchHeight };
}

function defined<T extends object>(given: T): Partial<T> {
  return Object.fromEntries(Object.entries(given).filter(([, value]) => value !== undefined)) as Partial<T>;
}

function bodyNumbers(body: Body): [number, number, number, number] {
  return body.shape === "box" ? [0, body.x, body.y, body.height] : [1, body.radius, 0, body.height];
}

function numbers(settings: Settings): Float64Array {
  const { body, climb, speed, gravity, jump, crouchHeight, maxDrop } = settings;
  return Float64Array.of(...bodyNumbers(body), climb, speed, gravity, jump, crouchHeight, maxDrop ?? Number.NaN);
}

/** Message of a step; the link adds the first number. */
function stepNumbers(walker: number, seconds: number, input: WalkerInput): Step {
  const [x, y] = input.toward ?? input.wish ?? [0, 0];
  const flags = (input.jump ? 1 : 0) | (input.crouch ? 2 : 0) | (input.fly ? 4 : 0) | (input.toward ? 8 : 0);
  return [0, walker, seconds, x, y, input.pace ?? 1, input.lift ?? 0, flags];
}

/** Parses the engine's twelve numbers. */
function state(numbers: ArrayLike<number>): WalkerState {
  const at = (n: number): number => numbers[n] ?? 0;
  return {
    at: [at(0), at(1), at(2)],
    ground: GROUNDS[at(3)] ?? "walking",
    stop: STOPS[at(4)] ?? null,
    speed: at(5),
    rise: at(6),
    crouched: at(7) !== 0,
    height: at(8),
    missing: at(9),
    ticks: at(10),
    steps: at(11),
  };
}

export async function makeWalker(link: Link, options: WalkerOptions): Promise<Walker> {
  const { at, ...given } = options;
  const settings = complete(given);
  const name = await link.call<number>({ call: "walker", settings: numbers(settings), at: Float64Array.from(at) });
  return new WalkerHandle(link, name, at, given);
}

class WalkerHandle implements Walker {
  state: WalkerState;
  private start: Vec3;
  private closed = false;

  constructor(
    private readonly link: Link,
    private readonly name: number,
    at: Vec3,
    private given: WalkerSettings,
  ) {
    this.start = at;
    const { height } = complete(given).body;
    this.state = state(Float64Array.of(...at, 0, 0, 0, 0, 0, height, 0, 0, 0));
  }

  async step(seconds: number, input: WalkerInput): Promise<WalkerState> {
    this.check();
    const answer = await this.link.step(stepNumbers(this.name, seconds, input));
    this.state = state(answer.slice(1));
    return this.state;
  }

  place(at: Vec3): Promise<WalkerState> {
    return this.told({ call: "place", walker: this.name, at: Float64Array.from(at) });
  }

  async set(settings: WalkerSettings): Promise<WalkerState> {
    const given = { ...this.given, ...defined(settings) };
    const told = await this.told({ call: "settings", walker: this.name, settings: numbers(complete(given)) });
    this.given = given;
    return told;
  }

  async record(): Promise<void> {
    const { at } = await this.told({ call: "record", walker: this.name });
    this.start = at;
  }

  async recording(): Promise<WalkerRecording> {
    this.check();
    const { steps, path } = await this.link.call<Recorded>({ call: "recording", walker: this.name });
    const options = { ...complete(this.given), at: this.start };
    return { version: 1, options, steps: Array.from(steps), path: Array.from(path) };
  }

  close(): void {
    if (!this.closed) {
      this.closed = true;
      this.link.note({ note: "forget", name: this.name });
    }
  }

  private check(): void {
    if (this.closed) {
      throw new SlicewalkError("invalid", "the walker is closed");
    }
  }

  private async told(call: Parameters<Link["call"]>[0]): Promise<WalkerState> {
    this.check();
    this.state = state(await this.link.call<Float64Array>(call));
    return this.state;
  }
}
