// The card of the first view: name and size of the scan, and the button that walks in.

import type { Bounds } from "slicewalk";
import { texts } from "../languages";
import { h, picture, icons, write } from "./dom";

export class FirstCard {
  readonly element = h("section", { class: "first", "aria-label": texts.first.label, hidden: true });
  readonly #name = h("h2");
  readonly #size = h("p", { class: "quiet" });
  readonly #button: HTMLButtonElement;

  constructor(walkIn: () => void) {
    this.#button = h("button", { type: "button", class: "primary walk-in", onclick: walkIn }, texts.first.walkIn);
    this.#button.prepend(picture(icons.walk));
    this.element.append(h("div", {}, this.#name, this.#size), this.#button);
  }

  show(name: string, { min, max }: Bounds): void {
    write(this.#name, name);
    const size = [0, 1, 2].map((axis) => (max[axis] ?? 0) - (min[axis] ?? 0));
    const digits = Math.max(...size) < 100 ? 1 : 0;
    write(this.#size, texts.first.size(size.map((metres) => metres.toFixed(digits)).join(" × ")));
    this.element.hidden = false;
    document.documentElement.classList.add("first-view");
  }

  hide(): void {
    this.element.hidden = true;
    document.documentElement.classList.remove("first-view");
  }
}
