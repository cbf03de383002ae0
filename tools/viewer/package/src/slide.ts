/** Moves along surfaces, as numbers. */

import { CONTACT_LENGTH, readContact, readSlide, SLIDE_LENGTH } from "./messages.js";
import type { Sliding } from "./protocol.js";
import type { Contact, PlacedShape, Slide, SlideOptions, Vec3 } from "./types.js";

/** Most contacts unless the caller says otherwise. */
const CONTACTS = 4;

function shapeNumbers(shape: PlacedShape): Float64Array {
  if ("min" in shape) {
    // By name, because the engine distinguishes shapes by the count of their numbers.
    const [[x0, y0, z0], [x1, y1, z1]] = [shape.min, shape.max];
    return Float64Array.of(x0, y0, z0, x1, y1, z1);
  }
  const [x, y, z] = shape.at;
  switch (shape.shape) {
    case "sphere":
      return Float64Array.of(x, y, z, shape.radius);
    case "cylinder":
      return Float64Array.of(x, y, z, shape.radius, shape.height);
    case "box":
      return Float64Array.of(x - shape.x / 2, y - shape.y / 2, z, x + shape.x / 2, y + shape.y / 2, z + shape.height);
  }
}

export function toSliding(shape: PlacedShape, motion: Vec3, { iterations = CONTACTS }: SlideOptions): Sliding {
  return { shape: shapeNumbers(shape), motion: Float64Array.from(motion), contacts: iterations };
}

export function toSlide(numbers: Float64Array): Slide {
  const { x, y, z, missing } = readSlide(numbers);
  const contacts: Contact[] = [];
  for (let at = SLIDE_LENGTH; at < numbers.length; at += CONTACT_LENGTH) {
    const { distance, normalX, normalY, normalZ, obstacle } = readContact(numbers, at);
    contacts.push({ distance, normal: [normalX, normalY, normalZ], obstacle: obstacle !== 0 });
  }
  return { motion: [x, y, z], contacts, missing: missing !== 0 };
}
