// Plant and law as formulas. What the server sends is text, and only its letters are set as mathematics.
import { byId, element } from "./dom.js";
import { nameElement } from "./numbers.js";

const TOKEN = /y_d\^\(\d+\)|[A-Za-z_]\w*'?|\d+(?:\.\d+)?(?:e[+-]?\d+)?|\*\*|\S|\s+/g;
const CALLED = /^(a?sin|a?cos|a?tan|sinh|cosh|tanh|exp|log|sqrt|sign|Abs|Max|Min|Heaviside|Piecewise|erf)$/;

/** Show what the present design's law is. */
export function showLaw({ plant, law, notes }) {
  const box = byId("law");
  box.textContent = "";
  for (const [title, formulas] of [["Plant", plant], ["Law", law]]) {
    box.append(element("h3", {}, title));
    for (const [text, number] of formulas) {
      const label = number ? element("span", { class: "number", title: `${number} of the paper` }, number) : "";
      box.append(element("p", { class: "formula" }, formula(text), label));
    }
  }
  if (plant.some(([text]) => text.startsWith("v' ="))) box.append(element("p", { class: "sub" }, "v is a state; ν (nu) is what u would be if its gain were 1"));
  for (const line of notes) box.append(element("p", { class: "sub" }, line.replace(/^kappa/, "κ")));
}

/** A formula of plain text with letters, indices and powers as they are written by hand. */
export function formula(text) {
  const box = element("span", { "aria-label": text, role: "math" });
  const tokens = text.match(TOKEN) ?? [];
  for (let k = 0; k < tokens.length; k += 1) {
    const token = tokens[k];
    if (token === "**" && /^[\w.]/.test(tokens[k + 1] ?? "")) box.append(element("sup", {}, tokens[(k += 1)]));
    else box.append(part(token));
  }
  return box;
}

function part(token) {
  const order = /^y_d\^\((\d+)\)$/.exec(token);
  if (order) return element("var", {}, nameElement("y_d"), element("sup", {}, `(${order[1]})`));
  if (token === "*") return "\u202f·\u202f"; // a line ends before a sign, not within a product
  if (token === "-") return "−";
  const powered = /^([\d.]+)e([+-]?)0*(\d+)$/.exec(token);
  if (powered) return element("span", { class: "whole" }, `${powered[1]}·10`, element("sup", {}, `${powered[2] === "-" ? "−" : ""}${powered[3]}`));
  if (!/^[A-Za-z_]/.test(token)) return token;
  const name = token.replace(/'$/, "");
  if (CALLED.test(name)) return token;
  return element("var", {}, nameElement(name), token === name ? "" : "′");
}
