// Input of a person, independent of the device.

export interface Intent {
  /** Forward and to the right, -1 to 1. */
  forward: number;
  right: number;
  /** Turning right and looking up, -1 to 1 of the usual speed. */
  turn: number;
  tilt: number;
  /** Upwards while flying. */
  lift: number;
  run: boolean;
  jump: boolean;
  crouch: boolean;
}

export const nothing = (): Intent => ({
  forward: 0,
  right: 0,
  turn: 0,
  tilt: 0,
  lift: 0,
  run: false,
  jump: false,
  crouch: false,
});

export function joined(intents: readonly Intent[]): Intent {
  const all = nothing();
  for (const intent of intents) {
    all.forward += intent.forward;
    all.right += intent.right;
    all.turn += intent.turn;
    all.tilt += intent.tilt;
    all.lift += intent.lift;
    all.run ||= intent.run;
    all.jump ||= intent.jump;
    all.crouch ||= intent.crouch;
  }
  return all;
}

/** Whether a person steers. Not by crouching, which may last without a hand. */
export const steers = ({ forward, right, turn, tilt, lift, jump }: Intent): boolean =>
  forward !== 0 || right !== 0 || turn !== 0 || tilt !== 0 || lift !== 0 || jump;

export const moves = ({ forward, right, jump }: Intent): boolean => forward !== 0 || right !== 0 || jump;
