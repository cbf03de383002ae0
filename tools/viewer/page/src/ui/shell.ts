// The layout: the canvas below, bars and panels above it.

import type { ArchiveInfo, Bounds } from "slicewalk";
import type { Colouring } from "../scene/material";
import type { Settings } from "../settings";
import { texts } from "../languages";
import { ColoursPanel } from "./colours";
import { h, icons, picture } from "./dom";
import { FirstCard } from "./first";
import { MeasurePanel } from "./measure";
import { Messages } from "./messages";
import type { Minimap } from "./minimap";
import { OverlayFields, type OverlayEvents } from "./overlays";
import { PlanBar } from "./plan";
import { SectionPanel } from "./section";
import { SettingsPanel } from "./settings";
import { SlicesPanel } from "./slices";
import { StatusPanel } from "./status";
import { Toolbars, type PanelName, type ToolEvents } from "./toolbars";
import { Welcome, type WelcomeEvents } from "./welcome";

export interface ShellEvents extends ToolEvents, WelcomeEvents, OverlayEvents {
  settings(settings: Settings): void;
  colouring(colouring: Colouring): void;
  blocks(blocks: boolean): void;
  slices(): void;
  plan(): void;
  walkIn(): void;
}

export class Shell {
  readonly canvas = h("canvas", { class: "view", tabindex: 0, role: "application", "aria-label": texts.title });
  readonly crosshair = h("div", { class: "crosshair", "aria-hidden": "true", hidden: true });
  /** Why the pawn does not get on. */
  readonly stop = h("div", { class: "stop", role: "status", hidden: true });
  readonly first: FirstCard;
  readonly foot: HTMLElement;
  readonly messages = new Messages();
  readonly status = new StatusPanel();
  readonly plan: PlanBar;
  readonly measure = new MeasurePanel();
  readonly slices: SlicesPanel;
  readonly section = new SectionPanel();
  readonly colours: ColoursPanel;
  readonly overlays: OverlayFields;
  readonly settings: SettingsPanel;
  readonly welcome: Welcome;
  readonly toolbars: Toolbars;
  readonly #name = h("h1", { class: "name" }, texts.title);
  readonly #left = h("div", { class: "left" });
  readonly #map = h("div", { class: "corner" });
  readonly #help = helpDialog();
  readonly #parent: HTMLElement;

  constructor(
    parent: HTMLElement,
    settings: Settings,
    readonly events: ShellEvents,
  ) {
    this.#parent = parent;
    this.settings = new SettingsPanel(settings, events.settings);
    this.overlays = new OverlayFields(events);
    this.colours = new ColoursPanel(events.colouring, events.blocks, this.overlays.element);
    this.first = new FirstCard(events.walkIn);
    this.foot = h("div", { class: "foot" }, this.messages.news, this.first.element);
    this.slices = new SlicesPanel(events.slices);
    this.plan = new PlanBar(events.plan);
    this.welcome = new Welcome(events);
    this.toolbars = new Toolbars({ ...events, panel: (name) => this.#panel(name) });
    const head = h("header", { class: "head" }, this.#name, this.toolbars.modes, this.toolbars.tools);
    const panels = h(
      "div",
      { class: "right" },
      this.measure.element,
      this.slices.element,
      this.section.element,
      this.colours.element,
      this.settings.element,
    );
    this.#left.append(this.plan.element, this.status.element);
    const main = h(
      "main",
      {},
      this.canvas,
      this.crosshair,
      this.stop,
      head,
      panels,
      this.#left,
      this.#map,
      this.foot,
      this.messages.progress,
    );
    // After a mouse click the keys walk on; a person who reached a button by keyboard stays there.
    main.addEventListener("click", ({ detail, target }) => {
      if (detail > 0 && target instanceof Element && target.closest("button.tool")) this.canvas.focus({ preventScroll: true });
    });
    parent.append(main, this.welcome.element, this.welcome.curtain, this.messages.dialog, this.#help);
    parent.classList.add("empty");
  }

  opened(name: string, info: ArchiveInfo, content: Bounds, minimap: Minimap): void {
    this.#name.textContent = name;
    this.#name.title = name;
    document.title = `${name} – ${texts.title}`;
    this.canvas.setAttribute("aria-label", texts.viewOf(name));
    this.slices.open(info);
    this.section.open(content);
    this.#map.replaceChildren(minimap.element);
    this.#parent.classList.remove("empty");
    this.welcome.opened();
  }

  help(): void {
    if (!this.#help.open) this.#help.showModal();
  }

  #panel(name: PanelName | null): void {
    const { measure, slices, section, colours, settings } = this;
    Object.entries({ measure, slices, section, colours, settings }).forEach(
      ([key, panel]) => (panel.element.hidden = key !== name),
    );
    document.documentElement.classList.toggle("panel-open", name !== null);
    this.events.panel(name);
  }
}

function helpDialog(): HTMLDialogElement {
  const rows = texts.help.rows.map(([keys, what]) => h("tr", {}, h("th", { scope: "row" }, keys), h("td", {}, what)));
  const dialog = h("dialog", { class: "help", "aria-labelledby": "help-title" });
  const close = h(
    "button",
    { type: "button", class: "tool close", "aria-label": texts.tools.close, onclick: () => dialog.close() },
    picture(icons.close),
  );
  dialog.append(h("h2", { id: "help-title" }, texts.help.heading), close, h("table", {}, h("tbody", {}, ...rows)));
  return dialog;
}
