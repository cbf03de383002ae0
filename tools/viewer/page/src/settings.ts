// Settings of a person, stored by the browser.

import type { WalkerSettings } from "slicewalk";
import { clamp } from "./geometry";

export interface Settings {
  width: number;
  height: number;
  eye: number;
  climb: number;
  speed: number;
  jump: number;
  drop: number;
  slope: number;
  radius: number;
  field: number;
  sensitivity: number;
  /** Index of `QUALITIES` and of `THEMES`. */
  quality: number;
  theme: number;
}

export const QUALITIES = ["auto", "lowest", "best"] as const;
export const THEMES = ["auto", "light", "dark"] as const;

/** Settings that are a choice among words. */
export const choices: Partial<Record<keyof Settings, readonly string[]>> = { quality: QUALITIES, theme: THEMES };

export interface Limit {
  readonly usual: number;
  readonly min: number;
  readonly max: number;
  readonly step: number;
}

export const limits: Record<keyof Settings, Limit> = {
  width: { usual: 0.5, min: 0.1, max: 3, step: 0.05 },
  height: { usual: 1.8, min: 0.5, max: 4, step: 0.05 },
  eye: { usual: 1.65, min: 0.2, max: 3.9, step: 0.05 },
  climb: { usual: 0.35, min: 0, max: 0.45, step: 0.01 },
  speed: { usual: 1.4, min: 0.2, max: 20, step: 0.1 },
  jump: { usual: 0.5, min: 0, max: 3, step: 0.05 },
  drop: { usual: 2, min: 0, max: 10, step: 0.1 },
  slope: { usual: 45, min: 1, max: 89, step: 1 },
  radius: { usual: 40, min: 5, max: 400, step: 5 },
  field: { usual: 70, min: 40, max: 100, step: 1 },
  sensitivity: { usual: 1, min: 0.1, max: 5, step: 0.1 },
  quality: { usual: 0, min: 0, max: 2, step: 1 },
  theme: { usual: 0, min: 0, max: 2, step: 1 },
};

const KEY = "slicewalk.settings";
const names = Object.keys(limits) as (keyof Settings)[];

export function usualSettings(): Settings {
  return Object.fromEntries(names.map((name) => [name, limits[name].usual])) as unknown as Settings;
}

/** Clamps to the limits; the eye stays inside the body, and the climb height below the body's height. */
export function sound(settings: Settings): Settings {
  const kept = { ...settings };
  for (const name of names) {
    const { usual, min, max } = limits[name];
    kept[name] = Number.isFinite(kept[name]) ? clamp(kept[name], min, max) : usual;
  }
  kept.eye = Math.min(kept.eye, kept.height - 0.05);
  return kept;
}

export function loadSettings(): Settings {
  try {
    return sound({ ...usualSettings(), ...JSON.parse(localStorage.getItem(KEY) ?? "{}") });
  } catch {
    return usualSettings(); // no storage, or invalid JSON
  }
}

export function saveSettings(settings: Settings): void {
  try {
    localStorage.setItem(KEY, JSON.stringify(settings));
  } catch {
    // A private window has no storage: the settings last as long as the page.
  }
}

export function walkerSettings(settings: Settings): WalkerSettings {
  return {
    body: { shape: "box", x: settings.width, y: settings.width, height: settings.height },
    climb: settings.climb,
    speed: settings.speed,
    jump: settings.jump,
    maxDrop: settings.drop > 0 ? settings.drop : null,
  };
}
