// What the page shows, in one place: the modules read it, and what belongs to them they change.

export const state = {
  system: null, base: "", text: "", name: "", saved: "", file: null, textOf: 0, asked: 0, revision: 0, design: 0, view: 0, window: null,
  run: null, bound: null, fast: null, worst: null, before: null, pins: [], connected: false, textProblem: null,
  greeting: null, restoring: null, failed: null, optima: null, tuneLimits: null,
};

// `asked` is the number of the newest text that was sent, `revision` that of the text on the page, `textOf` the
// design whose gains `text` has, `failed` the last one without a run; `file` is the name and the digest of what the design was read from.

/** Every change of gains or text is another design. */
export const nextDesign = () => (state.design += 1);

/** Every change of the window or the size is another view. */
export const nextView = () => (state.view = (state.view + 1) % 65536);
