// The first gamepad with the standard layout.

import { nothing, type Intent } from "./intent";

const DEAD = 0.15;

/** Maps a stick's value: zero near the middle, full at the edge. */
function stick(value: number | undefined): number {
  const size = Math.abs(value ?? 0);
  return size < DEAD ? 0 : Math.sign(value ?? 0) * Math.min(1, (size - DEAD) / (1 - DEAD));
}

/** Gamepads that may steer: other devices have axes of their own meaning, which rest anywhere. */
function pads(): readonly (Gamepad | null)[] {
  try {
    return navigator.getGamepads?.() ?? [];
  } catch {
    return []; // the page's host does not permit them
  }
}

export function readGamepad(): Intent {
  const pad = pads().find((pad) => pad?.connected === true && pad.mapping === "standard" && pad.axes.length >= 4);
  if (!pad) return nothing();
  const held = (...buttons: number[]): boolean => buttons.some((button) => pad.buttons[button]?.pressed === true);
  const [jump, crouch] = [held(0), held(1)];
  return {
    forward: -stick(pad.axes[1]),
    right: stick(pad.axes[0]),
    turn: stick(pad.axes[2]),
    tilt: -stick(pad.axes[3]),
    lift: Number(jump) - Number(crouch),
    run: held(4, 5, 10),
    jump,
    crouch,
  };
}
