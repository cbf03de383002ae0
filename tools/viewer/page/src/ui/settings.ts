// The settings panel: one labelled number per setting.

import { limits, sound, usualSettings, type Settings } from "../settings";
import { texts } from "../texts.en";
import { h } from "./dom";

const NAMES = Object.keys(limits) as (keyof Settings)[];

export class SettingsPanel {
  readonly element = h("section", { class: "panel settings", "aria-label": texts.settings.label, hidden: true });
  readonly #inputs = new Map<keyof Settings, HTMLInputElement>();

  constructor(
    settings: Settings,
    readonly changed: (settings: Settings) => void,
  ) {
    this.element.append(h("h2", {}, texts.settings.label));
    for (const name of NAMES) {
      const { min, max, step } = limits[name];
      const input = h("input", {
        type: "number",
        id: `set-${name}`,
        min,
        max,
        step,
        onchange: () => this.changed(sound(this.#read())),
      });
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
    this.#inputs.forEach((input, name) => (read[name] = input.valueAsNumber));
    return read;
  }
}
