// What the true gap at Z=0 means for a first layer, by its size.

// mm: up to the first one it is right, up to the second one a print still does
const RIGHT = 0.02, NEAR = 0.1;

// A class for its colour, and words. `gap`: mm above the bed as it is shown, null: not known;
// `wanted`: how far above the bed Z=0 is left on purpose, for a sheet of paper to say the rest.
export function verdict(gap, wanted) {
  if (gap === null) return ["", "Press Home, and it is known"];
  const off = Math.abs(gap);
  if (off <= RIGHT) return ["good", "right on the bed: a first layer comes out as it should"];
  if (gap > 0 && gap <= wanted) return ["good", `above the bed on purpose, by up to ${wanted} mm: bring it down with a sheet of paper`];
  if (off <= NEAR && gap > 0) return ["warn", "a little too high: the lines of a first layer would hardly hold"];
  if (off <= NEAR) return ["warn", "a little too low: a first layer would be squeezed flat"];
  if (gap > 0) return ["bad", "too high: a first layer would not stick"];
  return ["bad", "in the bed: a print would scratch the plate"];
}
