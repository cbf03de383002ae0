// Two on-screen thumb sticks for touch screens; they appear with the first touch.

import type { create as createSticks } from "nipplejs";
import { h } from "../ui/dom";
import { texts } from "../languages";
import { nothing, type Intent } from "./intent";

export class Sticks {
  readonly #intent = nothing();
  #made = false;

  constructor(parent: HTMLElement) {
    const show = (event: PointerEvent): void => {
      if (event.pointerType !== "touch" || this.#made) return;
      this.#made = true;
      void this.#make(parent);
    };
    window.addEventListener("pointerdown", show);
    if (matchMedia("(pointer: coarse)").matches) {
      this.#made = true;
      void this.#make(parent);
    }
  }

  read(): Intent {
    return this.#intent;
  }

  async #make(parent: HTMLElement): Promise<void> {
    const { create } = await import("nipplejs");
    const intent = this.#intent;
    const zone = (side: "left" | "right", label: string): HTMLElement => {
      const element = h("div", { class: `stick ${side}`, role: "group", "aria-label": label });
      parent.append(element);
      return element;
    };
    const options = {
      mode: "static",
      position: { left: "50%", top: "50%" },
      size: 112,
      color: "#66717c",
      restOpacity: 0.5,
    } as const;
    const follow = (collection: ReturnType<typeof createSticks>, moved: (x: number, y: number) => void): void => {
      collection.on("move", (event: { data: { vector: { x: number; y: number } } }) =>
        moved(event.data.vector.x, event.data.vector.y),
      );
      collection.on("end", () => moved(0, 0));
    };
    follow(create({ ...options, zone: zone("left", texts.touch.move) }), (x, y) => {
      intent.right = x;
      intent.forward = y;
      intent.run = Math.hypot(x, y) > 0.97;
    });
    follow(create({ ...options, zone: zone("right", texts.touch.look) }), (x, y) => {
      intent.turn = x;
      intent.tilt = y;
    });
    const jump = h("button", { class: "jump", type: "button" }, texts.touch.jump);
    const hold =
      (held: boolean) =>
      (event: Event): void => {
        event.preventDefault();
        intent.jump = held;
        intent.lift = held ? 1 : 0;
      };
    jump.addEventListener("pointerdown", hold(true));
    for (const end of ["pointerup", "pointercancel", "pointerleave"]) jump.addEventListener(end, hold(false));
    parent.append(jump);
    document.documentElement.classList.add("touch");
  }
}
