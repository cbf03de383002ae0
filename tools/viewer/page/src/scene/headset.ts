// Walking with a headset (WebXR). The browser tracks the head above the floor of the room; the page moves that floor.

import { Group, PerspectiveCamera, Vector3, type WebGLRenderer } from "three";
import type { Vec3 } from "slicewalk";
import { wrap, type Look } from "../geometry";
import { nothing, type Intent } from "../input/intent";
import type { World } from "./world";

/** Turn of a flick of the right stick; smooth turning makes people sick. */
const SNAP_DEGREES = 30;
const FLICK = 0.6;
const DEAD = 0.15;
/** Buttons and axes of controllers with the layout `xr-standard`. */
const SQUEEZE = 1;
const LOWER = 4;
const STICK = [2, 3] as const;

export async function hasHeadset(): Promise<boolean> {
  try {
    return (await navigator.xr?.isSessionSupported("immersive-vr")) ?? false;
  } catch {
    return false; // not allowed here
  }
}

export class Headset {
  /** Floor of the room in the scene, with the head above it. */
  readonly room = new Group();
  readonly head = new PerspectiveCamera(70, 1, 0.04, 4000);
  #session: XRSession | null = null;
  #heading = 0;
  #flicked = false;
  #hasFloor = true;

  constructor(
    readonly renderer: WebGLRenderer,
    readonly changed: (worn: boolean) => void,
  ) {
    // WebXR looks along -z with y up; the scene has z up, and heading 0 is +y.
    this.room.rotation.order = "ZXY";
    this.room.rotation.x = Math.PI / 2;
    this.room.add(this.head);
  }

  get worn(): boolean {
    return this.#session !== null;
  }

  /** Starts drawing for the headset, looking where the pawn looks. Fails if the person or the browser refuses. */
  async enter(heading: number): Promise<void> {
    if (this.#session !== null || navigator.xr === undefined) return;
    const session = await navigator.xr.requestSession("immersive-vr", { optionalFeatures: ["local-floor"] });
    const { xr } = this.renderer;
    this.#hasFloor = await session.requestReferenceSpace("local-floor").then(
      () => true,
      () => false,
    );
    xr.enabled = true;
    xr.setReferenceSpaceType(this.#hasFloor ? "local-floor" : "local");
    session.addEventListener("end", () => {
      xr.enabled = false;
      this.#session = null;
      this.changed(false);
    });
    await xr.setSession(session);
    this.#heading = heading;
    this.#session = session;
    this.changed(true);
  }

  async leave(): Promise<void> {
    await this.#session?.end();
  }

  /** Places the room's floor under the pawn, whose eye is at `eye`; returns where the person looks. */
  place(world: World, eye: Vec3, eyeHeight: number): Look {
    this.room.position.copy(world.local(eye));
    if (this.#hasFloor) this.room.position.z -= eyeHeight;
    this.room.rotation.z = (-this.#heading * Math.PI) / 180;
    this.room.updateMatrixWorld();
    this.renderer.xr.updateCamera(this.head);
    const ahead = new Vector3(0, 0, -1).transformDirection(this.head.matrixWorld);
    return {
      heading: wrap((Math.atan2(ahead.x, ahead.y) * 180) / Math.PI),
      pitch: (Math.asin(Math.min(1, Math.max(-1, ahead.z))) * 180) / Math.PI,
    };
  }

  /** Left stick walks, right stick turns; the lower button jumps, and the left grip runs. */
  read(): Intent {
    const intent = nothing();
    for (const { gamepad, handedness } of this.#session?.inputSources ?? []) {
      if (!gamepad) continue;
      const [x = 0, y = 0] = STICK.map((axis) => gamepad.axes[axis] ?? 0);
      const held = (button: number): boolean => gamepad.buttons[button]?.pressed === true;
      if (handedness === "left") {
        if (Math.hypot(x, y) > DEAD) Object.assign(intent, { forward: -y, right: x });
        intent.run ||= held(SQUEEZE);
      } else {
        if (Math.abs(x) > FLICK && !this.#flicked) this.#heading = wrap(this.#heading + Math.sign(x) * SNAP_DEGREES);
        this.#flicked = Math.abs(x) > FLICK;
        intent.jump ||= held(LOWER);
      }
    }
    return intent;
  }
}
