// Overlays drawn over the archive: a point cloud, and Gaussian splats that a person aligns.

import { ALIGNED, isUp, UPS, type Alignment } from "../scene/alignment";
import { texts } from "../languages";
import { h } from "./dom";

export interface OverlayEvents {
  cloud(shown: boolean): void;
  splats(shown: boolean): void;
  /** Shows or hides the archive itself. */
  matter(shown: boolean): void;
  align(alignment: Alignment): void;
}

const NUMBERS = ["x", "y", "z", "turn", "scale"] as const;
type NumberName = (typeof NUMBERS)[number];

export class OverlayFields {
  readonly element = h("div", { class: "overlays", hidden: true });
  readonly #cloud: HTMLInputElement;
  readonly #splats: HTMLInputElement;
  readonly #matter: HTMLInputElement;
  readonly #cloudField: HTMLElement;
  readonly #splatsField: HTMLElement;
  readonly #alignment = h("fieldset", { class: "alignment", hidden: true }, h("legend", {}, texts.overlays.alignment));
  readonly #numbers = new Map<NumberName, HTMLInputElement>();
  readonly #up = h("select", { id: "align-up" });

  constructor(readonly events: OverlayEvents) {
    const check = (name: "cloud" | "splats" | "matter"): readonly [HTMLInputElement, HTMLElement] => {
      const box = h("input", { type: "checkbox", id: `overlay-${name}` });
      box.addEventListener("change", () => events[name](box.checked));
      return [box, h("div", { class: "field check" }, box, h("label", { for: box.id }, texts.overlays[name]))];
    };
    let matterField;
    [this.#cloud, this.#cloudField] = check("cloud");
    [this.#splats, this.#splatsField] = check("splats");
    [this.#matter, matterField] = check("matter");
    const changed = (): void => events.align(this.#read());
    for (const name of NUMBERS) {
      const input = h("input", { type: "number", id: `align-${name}`, step: "any", onchange: changed });
      this.#numbers.set(name, input);
      this.#alignment.append(field(input.id, texts.overlays[name], input));
    }
    this.#up.append(...UPS.map((up) => h("option", { value: up }, texts.overlays.ups[up])));
    this.#up.addEventListener("change", changed);
    this.#alignment.append(field(this.#up.id, texts.overlays.up, this.#up));
    this.element.append(this.#cloudField, this.#splatsField, matterField, this.#alignment);
  }

  /** Shows which overlays exist and which of them are visible. */
  show(cloud: boolean | null, splats: boolean | null, matter: boolean): void {
    this.element.hidden = cloud === null && splats === null;
    this.#cloudField.hidden = cloud === null;
    this.#splatsField.hidden = splats === null;
    this.#alignment.hidden = splats !== true;
    [this.#cloud.checked, this.#splats.checked, this.#matter.checked] = [cloud === true, splats === true, matter];
  }

  set alignment({ at: [x, y, z], turn, scale, up }: Alignment) {
    Object.entries({ x, y, z, turn, scale }).forEach(([name, value]) => {
      const input = this.#numbers.get(name as NumberName);
      if (input) input.value = String(value);
    });
    this.#up.value = up;
  }

  #read(): Alignment {
    const number = (name: NumberName, otherwise: number): number => {
      const value = this.#numbers.get(name)?.valueAsNumber ?? NaN;
      return Number.isFinite(value) ? value : otherwise;
    };
    const scale = number("scale", 1);
    const up = this.#up.value;
    return {
      at: [number("x", 0), number("y", 0), number("z", 0)],
      turn: number("turn", 0),
      scale: scale > 0 ? scale : 1,
      up: isUp(up) ? up : ALIGNED.up,
    };
  }
}

function field(id: string, label: string, input: HTMLElement): HTMLElement {
  return h("div", { class: "field" }, h("label", { for: id }, label), input);
}
