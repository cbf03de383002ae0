// A small file of Gaussian splats as training programs write it: a block of a colour that no archive has.

const FIELDS = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split(" ");
/** Factor of the constant part of colours. */
const SH_0 = 0.28209479177387814;

/** A cube of 27 splats around the origin, 1 m wide, in full magenta. */
export function magentaCube() {
  const rows = [];
  const steps = [-0.4, 0, 0.4];
  for (const x of steps) for (const y of steps) for (const z of steps) rows.push([x, y, z]);
  const head = [
    "ply",
    "format binary_little_endian 1.0",
    `element vertex ${rows.length}`,
    ...FIELDS.map((name) => `property float ${name}`),
    "end_header\n",
  ];
  const colour = [1, 0, 1].map((value) => (value - 0.5) / SH_0);
  const size = [0.2, 0.2, 0.2].map(Math.log);
  const values = rows.flatMap((at) => [...at, ...colour, 6, ...size, 1, 0, 0, 0]);
  return Buffer.concat([Buffer.from(head.join("\n")), Buffer.from(Float32Array.from(values).buffer)]);
}
