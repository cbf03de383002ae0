// Written by a test of the engine (engine/src/messages.rs), which defines these messages; do not edit.

/** What a pawn does. */
export const GROUND_CODE = ["walking", "falling", "blocked", "flying"] as const;

/** Activity of a walker of a crowd. */
export const MEMBER_CODE = ["walking", "falling", "blocked", "arrived"] as const;

/** What blocked a pawn. */
export const STOP_CODE = ["none", "wall", "steep", "headroom", "corner", "inside", "ledge", "void"] as const;

/** State of a route. */
export const ROUTE_CODE = ["found", "unfinished", "not-loaded", "not-standing-from", "not-standing-to", "not-connected", "too-far"] as const;

/** Actions of the worker. */
export const ACTION_CODE = ["wait", "fetch", "cancel", "fetch-colours"] as const;

/** Shape and abilities of a pawn (m, s). */
export interface SettingsMessage {
  /** 0 box, 1 cylinder. */
  readonly shape: number;
  /** Edge along x, or the radius. */
  readonly x: number;
  /** Edge along y. */
  readonly y: number;
  /** Height of the body. */
  readonly height: number;
  /** Highest step. */
  readonly climb: number;
  /** Walking speed. */
  readonly speed: number;
  /** Acceleration downwards. */
  readonly gravity: number;
  /** Height of a jump. */
  readonly jump: number;
  /** Height while crouching. */
  readonly crouch: number;
  /** Deepest drop that the pawn walks over; NaN: any. */
  readonly maxDrop: number;
}

export function readSettings(numbers: ArrayLike<number>, at = 0): SettingsMessage {
  return {
    shape: numbers[at] ?? 0,
    x: numbers[at + 1] ?? 0,
    y: numbers[at + 2] ?? 0,
    height: numbers[at + 3] ?? 0,
    climb: numbers[at + 4] ?? 0,
    speed: numbers[at + 5] ?? 0,
    gravity: numbers[at + 6] ?? 0,
    jump: numbers[at + 7] ?? 0,
    crouch: numbers[at + 8] ?? 0,
    maxDrop: numbers[at + 9] ?? 0,
  };
}

export function writeSettings(message: SettingsMessage): number[] {
  return [
    message.shape,
    message.x,
    message.y,
    message.height,
    message.climb,
    message.speed,
    message.gravity,
    message.jump,
    message.crouch,
    message.maxDrop,
  ];
}

/** Numbers of a `SettingsMessage`. */
export const SETTINGS_LENGTH = 10;

/** Input of a pawn for the time of a step. */
export interface InputMessage {
  /** Direction, or the place to walk to: x. */
  readonly x: number;
  /** Direction, or the place to walk to: y. */
  readonly y: number;
  /** Factor of the walking speed. */
  readonly pace: number;
  /** Up or down while flying, -1 to 1. */
  readonly lift: number;
  /** 1 jump, 2 crouch, 4 fly, 8 walk to the place, 32 along the route. */
  readonly flags: number;
}

export function readInput(numbers: ArrayLike<number>, at = 0): InputMessage {
  return {
    x: numbers[at] ?? 0,
    y: numbers[at + 1] ?? 0,
    pace: numbers[at + 2] ?? 0,
    lift: numbers[at + 3] ?? 0,
    flags: numbers[at + 4] ?? 0,
  };
}

export function writeInput(message: InputMessage): number[] {
  return [
    message.x,
    message.y,
    message.pace,
    message.lift,
    message.flags,
  ];
}

/** Numbers of a `InputMessage`. */
export const INPUT_LENGTH = 5;

/** State of a pawn (m, m/s). */
export interface StateMessage {
  /** Feet: x. */
  readonly x: number;
  /** Feet: y. */
  readonly y: number;
  /** Feet: z. */
  readonly z: number;
  /** Number of a `GroundCode`. */
  readonly ground: number;
  /** Number of a `StopCode`. */
  readonly stop: number;
  /** Horizontal speed over the last step. */
  readonly speed: number;
  /** Upward speed over the last step. */
  readonly rise: number;
  /** 1 if it crouches. */
  readonly crouched: number;
  /** Height of the body now. */
  readonly height: number;
  /** Pages that the last step waited for. */
  readonly missing: number;
  /** Ticks that passed. */
  readonly ticks: number;
  /** Steps answered. */
  readonly steps: number;
  /** Places of its route that lie ahead. */
  readonly ahead: number;
}

export function readState(numbers: ArrayLike<number>, at = 0): StateMessage {
  return {
    x: numbers[at] ?? 0,
    y: numbers[at + 1] ?? 0,
    z: numbers[at + 2] ?? 0,
    ground: numbers[at + 3] ?? 0,
    stop: numbers[at + 4] ?? 0,
    speed: numbers[at + 5] ?? 0,
    rise: numbers[at + 6] ?? 0,
    crouched: numbers[at + 7] ?? 0,
    height: numbers[at + 8] ?? 0,
    missing: numbers[at + 9] ?? 0,
    ticks: numbers[at + 10] ?? 0,
    steps: numbers[at + 11] ?? 0,
    ahead: numbers[at + 12] ?? 0,
  };
}

export function writeState(message: StateMessage): number[] {
  return [
    message.x,
    message.y,
    message.z,
    message.ground,
    message.stop,
    message.speed,
    message.rise,
    message.crouched,
    message.height,
    message.missing,
    message.ticks,
    message.steps,
    message.ahead,
  ];
}

/** Numbers of a `StateMessage`. */
export const STATE_LENGTH = 13;

/** State of a crowd. */
export interface CrowdMessage {
  /** Pages that the last step waited for. */
  readonly missing: number;
}

export function readCrowd(numbers: ArrayLike<number>, at = 0): CrowdMessage {
  return {
    missing: numbers[at] ?? 0,
  };
}

export function writeCrowd(message: CrowdMessage): number[] {
  return [
    message.missing,
  ];
}

/** Numbers of a `CrowdMessage`. */
export const CROWD_LENGTH = 1;

/** State of a walker of a crowd (m). */
export interface MemberMessage {
  /** Feet: x. */
  readonly x: number;
  /** Feet: y. */
  readonly y: number;
  /** Feet: z. */
  readonly z: number;
  /** Number of a `MemberCode`. */
  readonly activity: number;
}

export function readMember(numbers: ArrayLike<number>, at = 0): MemberMessage {
  return {
    x: numbers[at] ?? 0,
    y: numbers[at + 1] ?? 0,
    z: numbers[at + 2] ?? 0,
    activity: numbers[at + 3] ?? 0,
  };
}

export function writeMember(message: MemberMessage): number[] {
  return [
    message.x,
    message.y,
    message.z,
    message.activity,
  ];
}

/** Numbers of a `MemberMessage`. */
export const MEMBER_LENGTH = 4;

/** Outcome of a move along surfaces (m). */
export interface SlideMessage {
  /** Way moved: x. */
  readonly x: number;
  /** Way moved: y. */
  readonly y: number;
  /** Way moved: z. */
  readonly z: number;
  /** 1 if pages are missing ahead. */
  readonly missing: number;
}

export function readSlide(numbers: ArrayLike<number>, at = 0): SlideMessage {
  return {
    x: numbers[at] ?? 0,
    y: numbers[at + 1] ?? 0,
    z: numbers[at + 2] ?? 0,
    missing: numbers[at + 3] ?? 0,
  };
}

export function writeSlide(message: SlideMessage): number[] {
  return [
    message.x,
    message.y,
    message.z,
    message.missing,
  ];
}

/** Numbers of a `SlideMessage`. */
export const SLIDE_LENGTH = 4;

/** Contact of a move. */
export interface ContactMessage {
  /** Way until the contact (m). */
  readonly distance: number;
  /** Outward normal of the surface: x. */
  readonly normalX: number;
  /** Outward normal of the surface: y. */
  readonly normalY: number;
  /** Outward normal of the surface: z. */
  readonly normalZ: number;
  /** 1 if it is an obstacle. */
  readonly obstacle: number;
}

export function readContact(numbers: ArrayLike<number>, at = 0): ContactMessage {
  return {
    distance: numbers[at] ?? 0,
    normalX: numbers[at + 1] ?? 0,
    normalY: numbers[at + 2] ?? 0,
    normalZ: numbers[at + 3] ?? 0,
    obstacle: numbers[at + 4] ?? 0,
  };
}

export function writeContact(message: ContactMessage): number[] {
  return [
    message.distance,
    message.normalX,
    message.normalY,
    message.normalZ,
    message.obstacle,
  ];
}

/** Numbers of a `ContactMessage`. */
export const CONTACT_LENGTH = 5;

/** Memory and work of the engine. */
export interface StatsMessage {
  /** Pages in memory. */
  readonly residentPages: number;
  /** Their bytes. */
  readonly residentBytes: number;
  /** Bytes of the budget in use. */
  readonly usedBytes: number;
  /** Most bytes in use so far. */
  readonly peakBytes: number;
  /** The budget. */
  readonly budgetBytes: number;
  /** Pages loaded so far. */
  readonly loaded: number;
  /** Pages evicted so far. */
  readonly evicted: number;
  /** Pages that walkers wait for. */
  readonly missing: number;
  /** Pages whose geometry is not built yet. */
  readonly unbuilt: number;
}

export function readStats(numbers: ArrayLike<number>, at = 0): StatsMessage {
  return {
    residentPages: numbers[at] ?? 0,
    residentBytes: numbers[at + 1] ?? 0,
    usedBytes: numbers[at + 2] ?? 0,
    peakBytes: numbers[at + 3] ?? 0,
    budgetBytes: numbers[at + 4] ?? 0,
    loaded: numbers[at + 5] ?? 0,
    evicted: numbers[at + 6] ?? 0,
    missing: numbers[at + 7] ?? 0,
    unbuilt: numbers[at + 8] ?? 0,
  };
}

export function writeStats(message: StatsMessage): number[] {
  return [
    message.residentPages,
    message.residentBytes,
    message.usedBytes,
    message.peakBytes,
    message.budgetBytes,
    message.loaded,
    message.evicted,
    message.missing,
    message.unbuilt,
  ];
}

/** Numbers of a `StatsMessage`. */
export const STATS_LENGTH = 9;

/** What the worker has to do next. */
export interface ActionMessage {
  /** Number of an `ActionCode`. */
  readonly action: number;
  /** Name of the fetch. */
  readonly fetch: number;
  /** First byte; of `Wait`: milliseconds until the next poll, Infinity: after an event. */
  readonly start: number;
  /** End of the bytes. */
  readonly end: number;
}

export function readAction(numbers: ArrayLike<number>, at = 0): ActionMessage {
  return {
    action: numbers[at] ?? 0,
    fetch: numbers[at + 1] ?? 0,
    start: numbers[at + 2] ?? 0,
    end: numbers[at + 3] ?? 0,
  };
}

export function writeAction(message: ActionMessage): number[] {
  return [
    message.action,
    message.fetch,
    message.start,
    message.end,
  ];
}

/** Numbers of a `ActionMessage`. */
export const ACTION_LENGTH = 4;

/** Head of a built page (m). */
export interface PageMessage {
  /** Name of the page in its view. */
  readonly page: number;
  /** Tile column: x. */
  readonly tx: number;
  /** Tile column: y. */
  readonly ty: number;
  /** Layer of slices. */
  readonly layer: number;
  /** Place of position zero: x. */
  readonly x: number;
  /** Place of position zero: y. */
  readonly y: number;
  /** Place of position zero: z. */
  readonly z: number;
  /** Length of a unit of the positions: x. */
  readonly scaleX: number;
  /** Length of a unit of the positions: y. */
  readonly scaleY: number;
  /** Length of a unit of the positions: z. */
  readonly scaleZ: number;
  /** Lowest corner of the solid: x. */
  readonly minX: number;
  /** Lowest corner of the solid: y. */
  readonly minY: number;
  /** Lowest corner of the solid: z. */
  readonly minZ: number;
  /** Highest corner of the solid: x. */
  readonly maxX: number;
  /** Highest corner of the solid: y. */
  readonly maxY: number;
  /** Highest corner of the solid: z. */
  readonly maxZ: number;
  /** 0, or the overview level. */
  readonly level: number;
}

export function readPage(numbers: ArrayLike<number>, at = 0): PageMessage {
  return {
    page: numbers[at] ?? 0,
    tx: numbers[at + 1] ?? 0,
    ty: numbers[at + 2] ?? 0,
    layer: numbers[at + 3] ?? 0,
    x: numbers[at + 4] ?? 0,
    y: numbers[at + 5] ?? 0,
    z: numbers[at + 6] ?? 0,
    scaleX: numbers[at + 7] ?? 0,
    scaleY: numbers[at + 8] ?? 0,
    scaleZ: numbers[at + 9] ?? 0,
    minX: numbers[at + 10] ?? 0,
    minY: numbers[at + 11] ?? 0,
    minZ: numbers[at + 12] ?? 0,
    maxX: numbers[at + 13] ?? 0,
    maxY: numbers[at + 14] ?? 0,
    maxZ: numbers[at + 15] ?? 0,
    level: numbers[at + 16] ?? 0,
  };
}

export function writePage(message: PageMessage): number[] {
  return [
    message.page,
    message.tx,
    message.ty,
    message.layer,
    message.x,
    message.y,
    message.z,
    message.scaleX,
    message.scaleY,
    message.scaleZ,
    message.minX,
    message.minY,
    message.minZ,
    message.maxX,
    message.maxY,
    message.maxZ,
    message.level,
  ];
}

/** Numbers of a `PageMessage`. */
export const PAGE_LENGTH = 17;

/** Head of the colours of a page. */
export interface PaintMessage {
  /** Name of the view. */
  readonly view: number;
  /** Name of the page in it. */
  readonly page: number;
  /** Cells along an edge. */
  readonly edge: number;
}

export function readPaint(numbers: ArrayLike<number>, at = 0): PaintMessage {
  return {
    view: numbers[at] ?? 0,
    page: numbers[at + 1] ?? 0,
    edge: numbers[at + 2] ?? 0,
  };
}

export function writePaint(message: PaintMessage): number[] {
  return [
    message.view,
    message.page,
    message.edge,
  ];
}

/** Numbers of a `PaintMessage`. */
export const PAINT_LENGTH = 3;
