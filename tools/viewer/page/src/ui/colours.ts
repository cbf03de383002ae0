// Choice of the colouring, with its legend.

import { metres } from "../geometry";
import { COLOURINGS, FLOOR, OBSTACLE, RAMP, type Colouring } from "../scene/material";
import { texts } from "../languages";
import { h } from "./dom";

export class ColoursPanel {
  readonly element = h("section", { class: "panel colours", "aria-label": texts.colours.label, hidden: true });
  readonly #legend = h("div", { class: "legend" });
  readonly #blocks = h("input", { type: "checkbox", id: "show-blocks" });
  readonly #choices = new Map<Colouring, { input: HTMLInputElement; element: HTMLElement }>();
  #chosen: Colouring = "height";
  /** True once a person has chosen. */
  #isWish = false;

  constructor(
    readonly changed: (colouring: Colouring) => void,
    showBlocks: (blocks: boolean) => void,
    overlays: HTMLElement,
  ) {
    this.#blocks.addEventListener("change", () => showBlocks(this.blocks));
    const blocks = h("div", { class: "field check" }, this.#blocks, h("label", { for: "show-blocks" }, texts.colours.blocks));
    const choices = COLOURINGS.toReversed().map((name) => {
      const input = h("input", {
        type: "radio",
        name: "colouring",
        id: `colour-${name}`,
        value: name,
        checked: name === "height",
      });
      input.addEventListener("change", () => {
        [this.#chosen, this.#isWish] = [name, true];
        changed(name);
      });
      const element = h("div", { class: "choice" }, input, h("label", { for: `colour-${name}` }, texts.colours[name]));
      this.#choices.set(name, { input, element });
      return element;
    });
    this.element.append(h("fieldset", {}, h("legend", {}, texts.colours.label), ...choices), this.#legend, blocks, overlays);
  }

  /** Whether to draw what collides. */
  get blocks(): boolean {
    return this.#blocks.checked;
  }

  get chosen(): Colouring {
    return this.#chosen;
  }

  /** Selects the colours of the scan unless a person chose others, or there are none. */
  offer(scan: boolean): void {
    if (this.#chosen === "scan" && !scan) [this.#chosen, this.#isWish] = ["height", false];
    else if (scan && !this.#isWish) this.#chosen = "scan";
    for (const [name, { input, element }] of this.#choices) {
      element.hidden = name === "scan" && !scan;
      input.checked = name === this.#chosen;
    }
  }

  /** Shows the legend for heights from `low` to `high` and a slope limit. */
  show([low, high]: readonly [number, number], slope: number): void {
    const { legend } = texts;
    const swatch = (colour: string, words: string): HTMLElement => {
      const mark = h("span", { class: "swatch" });
      mark.style.background = colour;
      return h("span", { class: "entry" }, mark, words);
    };
    const bar = (colours: readonly string[], left: string, right: string): HTMLElement[] => {
      const strip = h("div", { class: "strip" });
      strip.style.background = `linear-gradient(to right, ${colours.join(", ")})`;
      return [strip, h("div", { class: "ends" }, h("span", {}, left), h("span", {}, right))];
    };
    const parts: Record<Colouring, () => HTMLElement[]> = {
      scan: () => [h("p", { class: "quiet" }, legend.scan)],
      height: () => bar(RAMP, `${metres(low, 1)} m`, `${metres(high, 1)} m`),
      slope: () => [...bar([RAMP[1], RAMP[3]], legend.flat, `${slope}°`), swatch(OBSTACLE, `${legend.steep} ${slope}°`)],
      obstacle: () => [swatch(FLOOR, legend.floor), swatch(OBSTACLE, legend.obstacle)],
      slice: () => [
        ...bar(["rgb(0,255,26)", "rgb(255,255,26)"], legend.floor, ""),
        ...bar(["rgb(0,255,255)", "rgb(255,255,255)"], legend.obstacle, ""),
        h("p", { class: "quiet" }, legend.inSlice),
      ],
    };
    this.#legend.replaceChildren(...parts[this.#chosen]());
  }
}
