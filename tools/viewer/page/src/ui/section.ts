// The section box: only what lies inside it is drawn.

import type { Bounds } from "slicewalk";
import { metres } from "../geometry";
import { texts } from "../languages";
import { h, write } from "./dom";

const SIDES = ["west", "east", "south", "north", "bottom", "top"] as const;
const STEPS = 500;

export class SectionPanel {
  readonly element = h("section", { class: "panel section", "aria-label": texts.tools.section, hidden: true });
  readonly #on = h("input", { type: "checkbox", id: "section-on" });
  readonly #sliders = SIDES.map((side) => h("input", { type: "range", id: `section-${side}`, min: 0, max: STEPS, step: 1 }));
  readonly #values = SIDES.map((side) => h("output", { for: `section-${side}` }));
  #bounds: Bounds = { min: [0, 0, 0], max: [0, 0, 0] };

  constructor() {
    const rows = SIDES.map((side, n) =>
      h(
        "div",
        { class: "field" },
        h("label", { for: `section-${side}` }, texts.section[side]),
        this.#sliders[n] as Node,
        this.#values[n] as Node,
      ),
    );
    this.#sliders.forEach((slider, n) =>
      slider.addEventListener("input", () => {
        this.#on.checked = true;
        // Opposite sides keep apart.
        const other = this.#sliders[n ^ 1] as HTMLInputElement;
        const isHigh = n % 2 === 1;
        const crosses = isHigh ? slider.valueAsNumber <= other.valueAsNumber : slider.valueAsNumber >= other.valueAsNumber;
        if (crosses) slider.value = String(other.valueAsNumber + (isHigh ? 1 : -1));
        this.#describe();
      }),
    );
    const whole = (): void => this.#whole();
    this.element.append(
      h("h2", {}, texts.tools.section),
      h("div", { class: "field check" }, this.#on, h("label", { for: "section-on" }, texts.section.on)),
      ...rows,
      h("button", { type: "button", class: "plain", onclick: whole }, texts.section.whole),
    );
  }

  open(bounds: Bounds): void {
    this.#bounds = bounds;
    this.#whole();
  }

  /** The box, or null: all is drawn. */
  get box(): Bounds | null {
    if (!this.#on.checked) return null;
    const [x0, x1, y0, y1, z0, z1] = SIDES.map((_, n) => this.#at(n)) as [number, number, number, number, number, number];
    return { min: [x0, y0, z0], max: [x1, y1, z1] };
  }

  #whole(): void {
    this.#on.checked = false;
    this.#sliders.forEach((slider, n) => (slider.value = String((n % 2) * STEPS)));
    this.#describe();
  }

  #at(n: number): number {
    const axis = (n >> 1) as 0 | 1 | 2;
    const [low, high] = [this.#bounds.min[axis], this.#bounds.max[axis]];
    return low + ((high - low) * (this.#sliders[n]?.valueAsNumber ?? 0)) / STEPS;
  }

  #describe(): void {
    this.#values.forEach((value, n) => write(value, `${metres(this.#at(n))} m`));
  }
}
