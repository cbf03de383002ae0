// The settings panel: one labelled number per setting.

import { choices, limits, sound, usualSettings, type Settings } from "../settings";
import { texts } from "../texts.en";
import { h } from "./dom";

const NAMES = Object.keys(limits) as (keyof Settings)[];

export class SettingsPanel {
  readonly element = h("section", { class: "panel settings", "aria-label": texts.settings.label, hidden: true });
  readonly #inputs = new Map<keyof Settings, HTMLInputElement | HTMLSelectElement>();

  constructor(
    settings: Settings,
    readonly changed: (settings: Settings) => void,
  ) {
    this.element.append(h("h2", {}, texts.settings.label));
    for (const name of NAMES) {
      const { min, max, step } = limits[name];
      const [id, onchange] = [`set-${name}`, (): void => this.changed(sound(this.#read()))];
      const words = choices[name]?.map((word, n) => h("option", { value: n }, texts.settings.choices[word] ?? word));
      const input =
        words === undefined
          ? h("input", { type: "number", id, min, max, step, onchange })
          : h("select", { id, onchange }, ...words);
      this.#inputs.set(name, input);
      this.element.append(h("div", { class: "field" }, h("label", { for: `set-${name}` }, texts.settings[name]), input));
    }
    const reset = (): void => this.changed(usualSettings());
    this.element.append(h("button", { type: "button", class: "plain", onclick: reset }, texts.settings.reset));
    this.show(settings);
  }

  show(settings: Settings): void {
    this.#inputs.forEach((input, name) => (input.value = String(settings[name])));
  }

  #read(): Settings {
    const read = { ...usualSettings() };
    this.#inputs.forEach((input, name) => (read[name] = input.value === "" ? NaN : Number(input.value)));
    return read;
  }
}
