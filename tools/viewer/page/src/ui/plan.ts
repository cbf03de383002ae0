// The bar of the plan view: its scale, and the plan as a file.

import { texts } from "../languages";
import { h, write } from "./dom";

export class PlanBar {
  readonly element = h("div", { class: "panel plan-bar", role: "group", "aria-label": texts.plan.label, hidden: true });
  readonly #bar = h("span", { class: "scale-bar" });
  readonly #cut = h("span", { class: "quiet" });

  constructor(save: () => void) {
    this.element.append(this.#bar, this.#cut, h("button", { type: "button", class: "tool", onclick: save }, texts.plan.save));
  }

  /** Shows the length of a step of the grid, this wide on the screen, and the height of the cut; null: hides the bar. */
  update(shown: { step: number; pixels: number; cut: string } | null): void {
    this.element.hidden = shown === null;
    if (shown === null) return;
    write(this.#bar, `${shown.step} m`);
    this.#bar.style.width = `${shown.pixels.toFixed(1)}px`;
    write(this.#cut, texts.plan.cutAt(shown.cut));
  }
}
