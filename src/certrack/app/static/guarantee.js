// The right-hand panel: the bound with its badge, where it comes from, measures, certificates, premises.
import { attribute, byId, element, style, write } from "./dom.js";
import { change, format, hasBound, worded, writeWords } from "./numbers.js";

const BADGES = { exact: ["exact", "exact"], refining: ["exact", "exact, refining"], estimating: ["estimating", "estimating"], none: ["bad", "no certificate"], contradicted: ["bad", "premise contradicted"], waiting: ["wait", "waiting"], stale: ["wait", "not current"], text: ["wait", "of the last good design"], unverified: ["estimating", "not verified"] };
const RUNGS = {
  simulated: "the largest error at the end of this run: of the truth of the file and this one disturbance",
  "worst found": "the largest error that a search over what the premises admit has found (Falsify): no run can be worse than certified",
  certified: "holds for every disturbance and parameter that the premises admit: so it lies above what one run shows",
};
const STATUSES = ["contradicted", "assumed", "checked", "proven"];
const LEAST_CHANGE = 0.005;
const LESS_IS_BETTER = new Set(["settling_time", "tail_error", "rms_error", "integral_abs_error", "peak_input", "input_energy", "input_variation"]);

export class Guarantee {
  /** `state` is read; `on`: edit(path, value). */
  constructor(state, on) {
    this.state = state;
    this.on = on;
    this.shown = "";
  }

  reset() {
    for (const id of ["facts", "ladder", "premises", "premise-count", "certificate-count", "announce"]) byId(id).textContent = "";
    for (const id of ["measures", "certificates"]) byId(id).tBodies[0].textContent = "";
    this.draw();
    this.tables();
  }

  badge(kind) {
    const [name, text] = BADGES[kind], badge = byId("badge");
    style(badge, `badge ${name}`);
    write(badge, text);
  }

  /** The run on the page; null if it is not of the present design and none will come. */
  get run() {
    const { run, failed, design } = this.state;
    return failed === design && run?.design !== design ? null : run;
  }

  /** What is known of the present design. */
  get kind() {
    const { run } = this, { bound, textProblem, connected } = this.state;
    if (!connected) return "stale";
    if (textProblem) return "text";
    if (!bound) return "waiting";
    if (bound.contradicted?.length) return "contradicted";
    if (!hasBound(bound)) return "none";
    if (!bound.exact || (run && run.design !== bound.design)) return "estimating";
    if (!bound.verified) return "unverified";
    return bound.refining ? "refining" : "exact";
  }

  draw() {
    const { bound, system, worst, design } = this.state;
    if (!system) return;
    const kind = this.kind, unit = system.units[0], header = this.run?.header;
    this.badge(kind);
    const big = byId("bound");
    write(big.children[0], hasBound(bound) ? "≤" : "");
    write(big.children[1], bound ? (hasBound(bound) ? bound.text : "none") : "—");
    write(big.children[2], hasBound(bound) ? unit : "");
    style(big, `big ${kind === "exact" || kind === "refining" ? "" : kind === "contradicted" ? "struck" : "muted"}`);
    writeWords(byId("meaning"), this.meaning(bound, kind));
    const now = worst && worst.design === design ? worst : null;
    this.ladder(header, now, bound, worst && !now);
    this.alarm(now, bound, unit);
    style(byId("facts"), bound?.exact ? "rows" : "rows old");
    const runKind = byId("run-kind");
    runKind.hidden = !system.drive || !header;
    write(runKind, header?.sampled ? "as the drive runs it" : "continuous");
  }

  meaning(bound, kind) {
    if (!bound) return "compiling …";
    if (kind === "contradicted") return `${bound.contradicted[0].name}: ${bound.contradicted[0].detail}: the bound does not apply to this file's own truth.`;
    if (!hasBound(bound)) return bound.reason || "no certificate";
    if (bound.exact && bound.loop === "implemented") return "largest |e₁| once settled, of the loop as the drive runs it, for everything the premises admit";
    if (bound.exact && bound.unrefined) return `largest |e₁| once settled, for everything the premises admit, by the fast proof. The finer one is missing: ${bound.unrefined}`;
    if (bound.exact && bound.refining && bound.reason.startsWith("of the continuous law")) return "largest |e₁| once settled, of the continuous law, by the fast proof; the finer one, of the loop as the drive runs it where that can be proven, is on its way";
    if (bound.exact && bound.reason) return `largest |e₁| once settled ${bound.reason}`;
    const all = "largest |e₁| once settled, for everything the premises admit";
    if (!bound.exact) return `${all}: estimated, which proves nothing; the proof follows`;
    return bound.refining ? `${all}, by the fast proof; a finer one, which may be smaller, is on its way` : all;
  }

  /** An admissible case beyond the bound, or a remedy of a contradicted premise. */
  alarm(worst, bound, unit) {
    const box = byId("remedy");
    const beyond = worst && bound?.exact && bound.verified && worst.alarm;
    const remedy = bound?.contradicted?.[0]?.remedy ?? "";
    const text = beyond ? `An admissible case (${worst.text} ${unit}) exceeds the bound (${bound.text} ${unit}): a premise is broken or certrack has a defect. Save the case.` : remedy;
    box.hidden = !text;
    if (box.dataset.text === text) return;
    box.dataset.text = text;
    box.textContent = text;
    for (const change of beyond ? [] : widenings(remedy, this.state.system.form)) box.append(element("button", { onclick: () => this.on.edit(change.path, change.value) }, change.text));
  }

  ladder(header, worst, bound, outdated) {
    const box = byId("ladder"), simulated = header?.metrics.tail_error, said = header?.texts.tail_error ?? "—";
    if (!box.childElementCount) {
      for (const [label, color] of [["simulated", "--output"], ["worst found", "--worst"], ["certified", "--bound"]]) {
        const bar = element("i");
        bar.style.background = `var(${color})`;
        box.append(element("span", { title: RUNGS[label] }, label), element("span", { class: "track" }, bar), element("b"));
      }
    }
    const values = [[simulated, said], [worst?.worst, worst ? worst.text : outdated ? "outdated" : "not searched"], [bound?.bound, hasBound(bound) ? bound.text : "—"]];
    const most = Math.max(...values.map(([value]) => (Number.isFinite(value) ? value : 0))) || 1; // an infinite one fills its track
    values.forEach(([value, text], k) => {
      box.children[3 * k + 1].firstChild.style.transform = `scaleX(${value > 0 ? Math.min(1, value / most) : 0})`;
      write(box.children[3 * k + 2], text ?? "—");
    });
    write(box.children[6], bound?.contradicted?.length ? "not certified" : bound && !bound.exact ? "estimated" : "certified");
    attribute(box, "aria-label", `simulated ${said}, ${worst ? `worst found ${worst.text}, ` : ""}${hasBound(bound) ? `bound ${bound.text}` : "no bound"}`);
  }

  measures(system, header, bound, before) {
    const body = byId("measures").tBodies[0], unit = system.units[0], input = system.units.at(-1);
    const units = { tail_error: unit, rms_error: unit, peak_input: input };
    const names = Object.keys(system.metrics);
    const labels = JSON.stringify([system.metrics, unit, input]);
    if (this.labels !== labels || !body.rows.length) {
      this.labels = labels;
      body.textContent = "";
      const row = (label, small) => body.append(element("tr", {}, element("th", { scope: "row", title: small ? `${label}, ${small}` : label }, ...worded(label), small ? element("small", {}, ` ${small}`) : null), element("td"), element("td"), element("td")));
      row("certified bound", unit);
      for (const name of names) row(system.metrics[name].replace(" [s]", ""), units[name] ?? (name === "settling_time" ? "s" : ""));
    }
    const fill = (row, old, now, oldValue, newValue, better) => {
      const cells = body.rows[row].cells, shift = change(oldValue, newValue);
      write(cells[1], old ?? "—");
      write(cells[2], now ?? "—");
      write(cells[3], shift);
      style(cells[3], better && shift[0] === "−" ? "down" : better && shift[0] === "+" ? "up" : "");
    };
    const alike = bound?.exact && !bound.contradicted?.length && bound.effort === before?.bound?.effort; // a fast proof may be worse than the finer one
    fill(0, before?.bound?.text, bound && (!hasBound(bound) || bound.contradicted?.length ? "none" : bound.exact ? bound.text : "estimating"), before?.bound?.bound, alike ? bound.bound : null, true);
    body.rows[0].cells[1].title = before?.bound?.effort === "fast" ? "by the fast proof: the finer one had not come" : "";
    const same = header && before?.run?.header.sampled === header.sampled;
    names.forEach((name, k) => fill(k + 1, same ? before.run.header.texts[name] : undefined, header?.texts[name], same ? before.run.header.metrics[name] : null, header?.metrics[name], LESS_IS_BETTER.has(name)));
  }

  /** Measures, and where the bound comes from. */
  tables() {
    const { bound, system, before } = this.state;
    this.measures(system, this.run?.header, bound, before);
    this.budget(bound);
  }

  /** All that only an exact result tells: rows are kept where they do not change. */
  proven(exact, system) {
    const facts = byId("facts");
    facts.textContent = "";
    const broken = exact.contradicted.length > 0, unit = system.units[0], rows = [["method", exact.method || "—"], ...(broken ? [] : exact.facts)];
    const simulated = this.run?.header.metrics.tail_error;
    if (exact.bound > 0 && simulated && !broken) rows.push(["certified / simulated", `${(exact.bound / simulated).toFixed(2)} ×`]);
    for (const [name, value] of rows) facts.append(element("dt", {}, name), element("dd", {}, value));
    const body = byId("certificates").tBodies[0];
    body.textContent = "";
    for (const entry of exact.certificates) {
      const best = entry.kind === exact.method;
      body.append(element("tr", { class: best ? "best" : "" }, element("th", { scope: "row", title: entry.reason || null }, entry.kind), element("td", {}, hasBound(entry) ? `${entry.text} ${unit}` : "—"), element("td", {}, entry.verified ? "verified" : "—")));
    }
    write(byId("certificate-count"), `${exact.certificates.filter((entry) => entry.verified).length} verified`);
    this.premises(exact.premises, broken);
  }

  premises(premises, broken) {
    const list = byId("premises"), counts = new Map();
    list.textContent = "";
    for (const premise of [...premises].sort((a, b) => STATUSES.indexOf(a.status) - STATUSES.indexOf(b.status))) {
      counts.set(premise.status, (counts.get(premise.status) ?? 0) + 1);
      const item = element("li", { class: premise.status }, element("span", { class: "vh" }, `${premise.status}: `), element("b", {}, ...worded(premise.name)), " ", ...worded(premise.detail));
      if (premise.remedy) item.append(element("em", {}, " ", ...worded(premise.remedy)));
      list.append(item);
    }
    write(byId("premise-count"), STATUSES.filter((status) => counts.has(status)).map((status) => `${counts.get(status)} ${status}`).join(", "));
    if (broken) byId("premises-card").open = true;
  }

  /** Why the bound is another one than before: the parts that have changed most, where both are of one method. */
  since(bound) {
    const { before, system } = this.state, was = bound?.effort === "default" ? before?.bound : before?.fast;
    const alike = was?.bound && bound?.bound && was.method === bound.method && was.shares_of === bound.shares_of && (bound.effort !== "default" || was.effort === "default");
    if (!alike || bound.sharesBefore || Math.abs(bound.bound / was.bound - 1) < LEAST_CHANGE) return "";
    const parts = new Map(bound.shares.map(([name, share]) => [name, share * bound.bound]));
    for (const [name, share] of was.shares) parts.set(name, (parts.get(name) ?? 0) - share * was.bound);
    const rose = bound.bound > was.bound, most = [...parts].filter(([, by]) => by > 0 === rose).sort(([, a], [, b]) => Math.abs(b) - Math.abs(a)).slice(0, 2);
    const own = bound.shares_of === bound.method; // of another method the order holds, not the size
    const words = most.map(([name, by]) => (own ? `${cause(name)} (${rose ? "+" : "−"}${format(Math.abs(by), 2)} ${system.units[0]}`.trim().concat(")") : cause(name)));
    return `${change(was.bound, bound.bound)} against before, mostly by ${words.join(" and ")}.`;
  }

  /** Shares of the bound, always in the same order. */
  budget(bound) {
    const box = byId("budget"), rows = [...(bound?.shares ?? [])].sort(([a], [b]) => (a < b ? -1 : 1));
    byId("budget-card").hidden = !rows.length;
    style(box, bound?.sharesBefore ? "bars old" : "bars");
    const key = rows.map(([name]) => name).join();
    if (this.shown !== key || box.childElementCount !== rows.length) {
      this.shown = key;
      box.textContent = "";
      for (const [name] of rows) box.append(element("div", { class: "bar" }, element("span", {}, cause(name)), element("span"), element("span", { class: "track" }, element("i"))));
    }
    rows.forEach(([, share], k) => {
      write(box.children[k].children[1], `${(100 * share).toFixed(0)} %`);
      box.children[k].querySelector("i").style.transform = `scaleX(${Math.min(1, Math.max(0, share))})`;
    });
    write(byId("budget-of"), bound?.shares_of && bound.shares_of !== bound.method ? `in the ${bound.shares_of}` : "");
    write(byId("budget-change"), this.since(bound));
    const most = rows.reduce((best, row) => (best && best[1] >= row[1] ? best : row), null);
    const [begin, whose] = bound?.shares_nominal ? ["Of the continuous law, with the constants as they stand: a", "its"] : ["A", "the"];
    write(byId("budget-hint"), most ? `${begin} tenth less of the largest part (${cause(most[0])}) lowers ${whose} bound by about ${(10 * most[1]).toFixed(1)} %.` : "");
  }
}

const SIGNS = { gamma: "γ", beta: "β" };

/** Remedies that one press carries out: "widen gamma[0] to 0.5" as an edit of the file. */
function widenings(remedy, form) {
  const fields = form.flatMap((section) => section.fields);
  return [...remedy.matchAll(/(gamma|beta)\[(\d+)\] to ([\d.e+-]*\d)/g)].flatMap(([, name, index, value]) => {
    const path = `plant.uncertainty.${name}`, written = fields.find((field) => field.path === path)?.value;
    try {
      const numbers = JSON.parse(written);
      numbers[Number(index)] = Number(value);
      return [{ path, value: `[${numbers.map((number) => JSON.stringify(number)).join(", ")}]`, text: `Widen ${SIGNS[name]} of w${lowered(String(Number(index) + 1))} to ${value}` }];
    } catch {
      return []; // not a list of numbers: the text says what to do
    }
  });
}

const lowered = (digits) => digits.replaceAll(/\d/g, (digit) => "₀₁₂₃₄₅₆₇₈₉"[digit]);

/** What adds to a bound, in words. */
export function cause(name) {
  const state = /^w_(\d+) \(state\)/.exec(name), disturbance = /^w_(\d+)/.exec(name), order = /^y_d\^\((\d+)\)/.exec(name);
  if (state) return `disturbance w${lowered(state[1])}, its growth with the state`;
  if (disturbance) return `disturbance w${lowered(disturbance[1])}`;
  if (order) return order[1] === "0" ? "reference" : `derivative ${order[1]} of the reference`;
  return name === "estimates" ? "unknown parameters" : name;
}

