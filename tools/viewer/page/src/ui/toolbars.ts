// The bar of views and tools. Tools that open a panel say so, and one panel is open at a time.

import type { Mode } from "../address";
import { texts } from "../languages";
import { h, icons, tool } from "./dom";

const PANELS = ["measure", "slices", "section", "colours", "settings"] as const;

export type PanelName = (typeof PANELS)[number];

export interface ToolEvents {
  mode(mode: Mode): void;
  fly(): void;
  panel(name: PanelName | null): void;
  link(): void;
  screenshot(): void;
  fullscreen(): void;
  headset(): void;
  help(): void;
  save(): void;
  open(): void;
  /** Back to the start, or to all of the scan. */
  home(): void;
}

const MODES: readonly Mode[] = ["walk", "orbit", "plan"];
const KEYS: Record<Mode, string | null> = { walk: null, orbit: "O", plan: "M" };

export class Toolbars {
  readonly modes: HTMLElement;
  readonly tools: HTMLElement;
  readonly #modes = new Map<Mode, HTMLButtonElement>();
  readonly #panels = new Map<PanelName, HTMLButtonElement>();
  readonly #fly: HTMLButtonElement;
  readonly #headset: HTMLButtonElement;
  #open: PanelName | null = null;

  constructor(readonly events: ToolEvents) {
    for (const mode of MODES) {
      this.#modes.set(
        mode,
        tool(icons[mode], texts.modes[mode], KEYS[mode], () => events.mode(mode)),
      );
    }
    this.modes = h("div", { class: "bar modes", role: "group", "aria-label": texts.modes.label }, ...this.#modes.values());
    this.#fly = tool(icons.fly, texts.tools.fly, "F", events.fly);
    for (const name of PANELS) {
      this.#panels.set(
        name,
        tool(icons[name], texts.tools[name], null, () => this.show(this.#open === name ? null : name)),
      );
    }
    this.#headset = tool(icons.headset, texts.tools.headset, null, events.headset);
    this.hasHeadset = this.worn = false;
    const others = [
      tool(icons.home, texts.tools.home, texts.tools.homeKey, events.home, true),
      this.#headset,
      tool(icons.link, texts.tools.link, null, events.link, true),
      tool(icons.screenshot, texts.tools.screenshot, null, events.screenshot, true),
      ...(document.fullscreenEnabled ? [tool(icons.fullscreen, texts.tools.fullscreen, null, events.fullscreen, true)] : []),
      tool(icons.save, texts.tools.save, null, events.save, true),
      tool(icons.open, texts.actions.other, null, events.open, true),
      tool(icons.help, texts.tools.help, "H", events.help, true),
    ];
    const all = [this.#fly, ...this.#panels.values(), ...others];
    this.tools = h("div", { class: "bar tools", role: "group", "aria-label": texts.tools.label }, ...all);
    this.mode = "walk";
    this.flying = false;
    this.show(null);
  }

  set mode(mode: Mode) {
    this.#modes.forEach((button, name) => button.setAttribute("aria-pressed", String(name === mode)));
  }

  set flying(flying: boolean) {
    this.#fly.setAttribute("aria-pressed", String(flying));
  }

  /** Offered only if the browser supports one. */
  set hasHeadset(has: boolean) {
    this.#headset.hidden = !has;
  }

  set worn(worn: boolean) {
    this.#headset.setAttribute("aria-pressed", String(worn));
  }

  get panel(): PanelName | null {
    return this.#open;
  }

  show(name: PanelName | null): void {
    // From a panel that closes, the focus goes back to its tool.
    const isWithin = Boolean(document.activeElement?.closest(".right .panel"));
    const closed = name === null && this.#open !== null && isWithin ? this.#panels.get(this.#open) : undefined;
    this.#open = name;
    this.#panels.forEach((button, panel) => button.setAttribute("aria-expanded", String(panel === name)));
    this.events.panel(name);
    closed?.focus();
  }
}
