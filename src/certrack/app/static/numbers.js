// Numbers as texts. What the server has said in words is shown as it is; here are sliders, cursor and axes.

/** A number with so many significant digits; e-notation outside 1e-4 .. 1e5. */
export function format(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "—";
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text = size >= 1e5 || size < 1e-4 ? value.toExponential(Math.max(0, digits - 2)) : value.toPrecision(digits);
  return minus(text);
}

/** A bound, rounded up in the last digit shown: what is printed is never below what is proven. */
export function roundedUp(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value) || value <= 0) return format(value, digits);
  const size = value >= 1e5 || value < 1e-4 ? digits - 1 : digits;
  let rounded = Number(value.toPrecision(size));
  if (rounded < value) {
    const step = 10 ** (Math.floor(Math.log10(value)) - size + 1);
    rounded = Number((rounded + step).toPrecision(size));
    if (rounded < value) rounded = Number((rounded + step).toPrecision(size));
  }
  return format(rounded, digits);
}

/** Whether there is a bound: 0 is one. */
export const hasBound = (one) => Number.isFinite(one?.bound);

/** The minus sign of mathematics, and a short exponent. */
export const minus = (text) => text.replaceAll("-", "−").replace("e+", "e");

/** What a person typed: a comma is a decimal point. */
export function typed(text) {
  const trimmed = text.trim().replace(",", ".").replace("−", "-");
  return trimmed === "" ? NaN : Number(trimmed);
}

/** A label of an axis. */
export function tick(value) {
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text = size >= 1e4 || size < 1e-3 ? value.toExponential(0) : String(Number(value.toPrecision(4)));
  return minus(text);
}

/** The change from one number to another, as people read it. */
export function change(before, now) {
  if (before === null || now === null || before === undefined || now === undefined || !before) return "";
  const part = now / before - 1, factor = Math.abs(part) + 1;
  if (!Number.isFinite(part)) return "";
  if (Math.abs(part) < 5e-4) return "=";
  const size = Math.abs(part);
  const shown = size >= 9.995 ? `${factor < 999.5 ? factor.toFixed(0) : format(factor, 3)}×` : `${(100 * size).toFixed(size < 0.0995 ? 1 : 0)} %`;
  return `${part < 0 ? "−" : "+"}${shown}`;
}

const GREEK = { alpha: "α", beta: "β", gamma: "γ", delta: "δ", epsilon: "ε", eta: "η", theta: "θ", kappa: "κ", lambda: "λ", mu: "μ", nu: "ν", xi: "ξ", pi: "π", rho: "ρ", sigma: "σ", tau: "τ", phi: "φ", chi: "χ", psi: "ψ", omega: "ω" };

/** A name such as theta_hat_1, omega_m or x1 as a letter, its mark, and an index below it. */
export function nameParts(name) {
  if (GREEK[name]) return [GREEK[name], ""]; // nu is no n with an index u
  const match = /^([A-Za-zΓδθρ]+?)(?:_?(hat|dot|ddot))?_?(\d+|[A-Za-z]?)?$/.exec(name);
  if (!match) return [name, ""];
  const [, word, mark, index] = match;
  let letter = GREEK[word] ?? word;
  if (letter.length > 1) return [name.replace(/(\d+)$/, ""), /\D\d+$/.test(name) ? /(\d+)$/.exec(name)[1] : ""];
  letter += { hat: "\u0302", dot: "\u0307", ddot: "\u0308" }[mark] ?? "";
  return [letter, index ?? ""];
}

/** An element that shows a name with its index; only text of the user's goes in, never markup. */
export function nameElement(name, tag = "span") {
  const [letter, index] = nameParts(name), element = document.createElement(tag);
  element.textContent = letter;
  if (index) {
    const below = document.createElement("sub");
    below.textContent = index;
    element.append(below);
  }
  return element;
}

const SYMBOL = new RegExp(`(?<![\\w.])((?:[A-Za-z]|${Object.keys(GREEK).join("|")})_(?:\\d+|[a-z]))(?:\\^\\((\\d+)\\))?(?!\\w)`);

/** A text in words whose symbols, such as e_1 and y_d^(2), are set as mathematics: a list of texts and elements. */
export function worded(text) {
  const parts = text.replaceAll("<=", "≤").replaceAll("||", "‖").split(SYMBOL), said = [];
  for (let k = 0; k < parts.length; k += 3) {
    said.push(parts[k]);
    if (k + 1 === parts.length) break;
    const symbol = nameElement(parts[k + 1]), order = Number(parts[k + 2] ?? 0);
    if (order) symbol.append(Object.assign(document.createElement("sup"), { textContent: `(${order})` }));
    said.push(symbol);
  }
  return said;
}

/** Set such a text if it differs from the one that stands there. */
export function writeWords(target, text) {
  if (target.dataset.words === text) return;
  target.dataset.words = text;
  target.replaceChildren(...worded(text));
}
