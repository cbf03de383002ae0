/** Walkers as seen by the page. */

import { across, duration, number, object, optional, place, refused, shown } from "./check.js";
import type { Host } from "./host.js";
import type { Link } from "./link.js";
import { GROUND_CODE, readState, ROUTE_CODE, type StateMessage, STOP_CODE, writeInput, writeSettings } from "./messages.js";
import type { Recorded, Routed } from "./protocol.js";
import {
  type Body,
  type Route,
  type RouteRefusal,
  SlicewalkError,
  type Vec3,
  type Walker,
  type WalkerInput,
  type WalkerOptions,
  type WalkerRecording,
  type WalkerSettings,
  type WalkerState,
} from "./types.js";

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
export function complete(given: WalkerSettings): Settings {
  const chosen = { ...DEFAULTS, ...defined(given) };
  const { height } = object(chosen.body, "a body");
  const crouchHeight = given.crouchHeight ?? Math.min(height, Math.max(0.6 * height, chosen.climb + 0.1));
  return { ...chosen, crouchHeight };
}

function defined<T extends object>(given: T): Partial<T> {
  return Object.fromEntries(Object.entries(given).filter(([, value]) => value !== undefined)) as Partial<T>;
}

function bodyNumbers(body: Body): { shape: number; x: number; y: number; height: number } {
  switch (body.shape) {
    case "box":
      return { shape: 0, x: number(body.x, "body.x"), y: number(body.y, "body.y"), height: number(body.height, "body.height") };
    case "cylinder":
      return { shape: 1, x: number(body.radius, "body.radius"), y: 0, height: number(body.height, "body.height") };
    default:
      throw refused(`a body is a box or a cylinder, found ${shown((body as { shape?: unknown }).shape)}`);
  }
}

export function settingsNumbers(settings: Settings): Float64Array {
  const { body, climb, speed, gravity, jump, crouchHeight, maxDrop } = settings;
  return Float64Array.from(
    writeSettings({
      ...bodyNumbers(body),
      climb: number(climb, "climb"),
      speed: number(speed, "speed"),
      gravity: number(gravity, "gravity"),
      jump: number(jump, "jump"),
      crouch: number(crouchHeight, "crouchHeight"),
      maxDrop: maxDrop === null ? Number.NaN : number(maxDrop, "maxDrop"),
    }),
  );
}

function inputNumbers(input: WalkerInput | undefined): number[] {
  const { toward, follow, wish, pace = 1, lift = 0, jump, crouch, fly } = optional(input, "an input");
  const [x, y]: readonly [number, number] = toward ? across(toward, "toward") : wish ? across(wish, "wish") : [0, 0];
  const flags = (jump ? 1 : 0) | (crouch ? 2 : 0) | (fly ? 4 : 0) | (toward ? 8 : 0) | (follow ? 32 : 0);
  return writeInput({ x, y, pace: number(pace, "pace"), lift: number(lift, "lift"), flags });
}

function toState({ x, y, z, ground, stop, crouched, ...rest }: StateMessage): WalkerState {
  const reason = STOP_CODE[stop] ?? "none";
  return {
    ...rest,
    at: [x, y, z],
    ground: GROUND_CODE[ground] ?? "walking",
    stop: reason === "none" ? null : reason,
    crouched: crouched !== 0,
  };
}

export async function makeWalker(link: Link, options: WalkerOptions): Promise<Walker> {
  const { at, ...given } = optional(options);
  const feet = place(at);
  const settings = settingsNumbers(complete(given));
  const name = await link.call<number>({ call: "walker", settings, at: Float64Array.from(feet) });
  return new WalkerHandle(link, name, feet, given);
}

export class WalkerHandle implements Walker {
  state: WalkerState;
  private start: Vec3;
  private closed = false;
  /** The last change of settings, until it is answered. */
  private setting: Promise<WalkerState> | undefined;

  constructor(
    private readonly link: Link,
    private readonly name: number,
    at: Vec3,
    private given: WalkerSettings,
  ) {
    this.start = at;
    const { height } = complete(given).body;
    const [x, y, z] = at;
    this.state = toState({ ...readState([]), x, y, z, height });
  }

  async step(seconds: number, input?: WalkerInput): Promise<WalkerState> {
    this.check();
    this.state = toState(readState(await this.link.step(this.name, duration(seconds), inputNumbers(input)), 1));
    return this.state;
  }

  /** Makes a step at once, with a host in this thread. */
  stepBy(link: Link, host: Host, seconds: number, input?: WalkerInput): WalkerState {
    if (link !== this.link) {
      throw new SlicewalkError("invalid", "this is no walker of the archive");
    }
    this.check();
    this.state = toState(readState(host.stepNow(this.name, duration(seconds), inputNumbers(input))));
    return this.state;
  }

  async place(at: Vec3): Promise<WalkerState> {
    return this.told({ call: "place", walker: this.name, at: Float64Array.from(place(at)) });
  }

  async set(settings: WalkerSettings): Promise<WalkerState> {
    const changes = defined(optional(settings));
    const change = async (): Promise<WalkerState> => {
      const given = { ...this.given, ...changes };
      const told = await this.told({ call: "settings", walker: this.name, settings: settingsNumbers(complete(given)) });
      this.given = given;
      return told;
    };
    // Each begins with what the one before has changed, or with nothing of it if that was refused.
    const changing = this.setting ? this.setting.then(change, change) : change();
    this.setting = changing;
    try {
      return await changing;
    } finally {
      if (this.setting === changing) {
        this.setting = undefined;
      }
    }
  }

  async route(to: Vec3, options?: { signal?: AbortSignal }): Promise<Route | RouteRefusal> {
    this.check();
    const { signal } = optional(options);
    const call = { call: "route", walker: this.name, to: Float64Array.from(place(to)) } as const;
    const { code, points } = await this.link.call<Routed>(call, signal);
    const outcome = ROUTE_CODE[code] ?? "not-connected";
    if (outcome !== "found") {
      return outcome as RouteRefusal;
    }
    const places = Array.from(
      { length: points.length / 3 },
      (_, n) => [...points.subarray(3 * n, 3 * n + 3)] as unknown as Vec3,
    );
    const legs = places.slice(1).map((place, n) => Math.hypot(...place.map((v, axis) => v - (places[n]?.[axis] ?? v))));
    return { points: places, length: legs.reduce((sum, leg) => sum + leg, 0) };
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
    this.state = toState(await this.link.call<StateMessage>(call));
    return this.state;
  }
}
