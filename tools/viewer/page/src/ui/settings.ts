// The settings panel: one labelled slider or choice per setting.

import { choices, limits, sound, usualSettings, type Settings } from "../settings";
import { texts } from "../languages";
import { h, write } from "./dom";

const NAMES = Object.keys(limits) as (keyof Settings)[];

export class SettingsPanel {
  readonly element = h("section", { class: "panel settings", "aria-label": texts.settings.label, hidden: true });
  readonly #inputs = new Map<keyof Settings, HTMLInputElement | HTMLSelectElement>();
  readonly #values = new Map<keyof Settings, HTMLOutputElement>();

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
          ? h("input", { type: "range", id, min, max, step, onchange, oninput: () => this.#describe() })
          : h("select", { id, onchange }, ...words);
      this.#inputs.set(name, input);
      const field = h("div", { class: words === undefined ? "field slide" : "field" });
      field.append(h("label", { for: id }, texts.settings[name]), input);
      if (words === undefined) {
        const value = h("output", { for: id });
        this.#values.set(name, value);
        field.append(value);
      }
      this.element.append(field);
    }
    const reset = (): void => this.changed(usualSettings());
    this.element.append(h("button", { type: "button", class: "plain", onclick: reset }, texts.settings.reset));
    this.show(settings);
  }

  show(settings: Settings): void {
    this.#inputs.forEach((input, name) => (input.value = String(settings[name])));
    this.#describe();
  }

  #describe(): void {
    this.#values.forEach((value, name) => write(value, this.#inputs.get(name)?.value ?? ""));
  }

  #read(): Settings {
    const read = { ...usualSettings() };
    this.#inputs.forEach((input, name) => (read[name] = input.value === "" ? NaN : Number(input.value)));
    return read;
  }
}
