/** Crowds as seen by the page. */

import { copied, duration, optional, rows } from "./check.js";
import type { Host } from "./host.js";
import type { Link } from "./link.js";
import { CROWD_LENGTH, MEMBER_LENGTH, readCrowd, readMember } from "./messages.js";
import { type Crowd, type CrowdOptions, type CrowdState, SlicewalkError } from "./types.js";
import { complete, settingsNumbers } from "./walker.js";

function toState(numbers: Float64Array): CrowdState {
  const count = (numbers.length - CROWD_LENGTH) / MEMBER_LENGTH;
  const state = { places: new Float64Array(3 * count), activities: new Uint8Array(count), missing: readCrowd(numbers).missing };
  for (let member = 0; member < count; member++) {
    const { x, y, z, activity } = readMember(numbers, CROWD_LENGTH + MEMBER_LENGTH * member);
    state.places.set([x, y, z], 3 * member);
    state.activities[member] = activity;
  }
  return state;
}

export async function makeCrowd(link: Link, options: CrowdOptions): Promise<Crowd> {
  const { at, ...given } = optional(options);
  const places = copied(at, "places of a crowd");
  const settings = settingsNumbers(complete(given));
  return new CrowdHandle(link, await link.call<number>({ call: "crowd", settings, places }), places);
}

export class CrowdHandle implements Crowd {
  state: CrowdState;
  private closed = false;

  constructor(
    private readonly link: Link,
    private readonly name: number,
    places: Float64Array,
  ) {
    this.state = { places, activities: new Uint8Array(places.length / 3), missing: 0 };
  }

  async step(seconds: number, wishes: Float64Array): Promise<CrowdState> {
    this.check();
    const copy = copied(wishes, "wishes of a crowd");
    const call = { call: "step-crowd", crowd: this.name, seconds: duration(seconds), wishes: copy } as const;
    this.state = toState(await this.link.call<Float64Array>(call, undefined, [copy.buffer]));
    return this.state;
  }

  /** Makes a step at once, with a host in this thread. */
  stepBy(link: Link, host: Host, seconds: number, wishes: Float64Array): CrowdState {
    if (link !== this.link) {
      throw new SlicewalkError("invalid", "this is no crowd of the archive");
    }
    this.check();
    const numbers = host.stepCrowdNow(this.name, duration(seconds), rows(wishes, "wishes of a crowd"));
    this.state = toState(numbers);
    return this.state;
  }

  close(): void {
    if (!this.closed) {
      this.closed = true;
      this.link.note({ note: "forget", name: this.name });
    }
  }

  private check(): void {
    if (this.closed) {
      throw new SlicewalkError("invalid", "the crowd is closed");
    }
  }
}
