// What a page of stillpoint does in the browser: sort and filter its tables, draw its plots, follow the colour scheme.
// The page holds its data as JSON in <script id="page-data">; Bokeh draws. Nothing is fetched.
"use strict";

// --- tables: a header cell's button sorts, a search field filters by the text columns

function sortTable(button) {
  const header = button.closest("th"), table = header.closest("table"), body = table.tBodies[0];
  const column = [...header.parentElement.children].indexOf(header);
  const rising = header.getAttribute("aria-sort") !== "ascending";
  for (const other of header.parentElement.children) other.removeAttribute("aria-sort");
  header.setAttribute("aria-sort", rising ? "ascending" : "descending");
  const keyOf = (row) => {
    const cell = row.children[column];
    const text = cell.dataset.value ?? cell.textContent.trim();
    const number = Number(text);
    return text === "" || Number.isNaN(number) ? text.toLowerCase() : number;
  };
  const keyed = [...body.rows].map((row) => [keyOf(row), row]);
  const missing = (key) => key === "" || key === "–";
  keyed.sort(([a], [b]) => {
    if (missing(a) || missing(b)) return missing(a) - missing(b); // rows without a value stay below
    const order = typeof a === typeof b ? (a > b) - (a < b) : typeof a === "number" ? -1 : 1;
    return rising ? order : -order;
  });
  body.append(...keyed.map(([, row]) => row));
}

function filterTable(field) {
  const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
  const rows = [...document.getElementById(field.dataset.table).tBodies[0].rows];
  for (const row of rows) {
    const text = [...row.querySelectorAll("th, td.text")].map((cell) => cell.textContent.toLowerCase()).join(" ");
    row.hidden = !words.every((word) => text.includes(word));
  }
  const shown = rows.filter((row) => !row.hidden).length;
  document.getElementById(`${field.dataset.table}-count`).textContent = `${shown} of ${rows.length} rows`;
}

// --- curves: 16-bit integers in base64 become columns; columns are merged to what the plot can show

function decodeCurve(encoded) {
  const bytes = Uint8Array.from(atob(encoded.data), (letter) => letter.charCodeAt(0));
  const whole = new Uint16Array(bytes.buffer);
  const unit = (encoded.high - encoded.low) / 65533;
  const values = Float64Array.from(whole, (level) => (level === 0 ? NaN : encoded.low + (level - 1) * unit));
  if (encoded.scale === "log") values.forEach((value, k) => (values[k] = Math.exp(value)));
  const count = values.length / 3;
  const part = (k) => values.subarray(k * count, (k + 1) * count);
  return { ...encoded, count, least: part(0), greatest: part(1), middle: part(2) };
}

function mergeColumns(curve, from, to, most) {
  // The columns between two times, merged so that at most `most` remain. Every least and greatest value is kept.
  const first = Math.max(0, Math.floor((from - curve.start) / curve.step) - 1);
  const last = Math.min(curve.count, Math.ceil((to - curve.start) / curve.step) + 1);
  const group = Math.max(1, Math.ceil((last - first) / most));
  const merged = { t: [], least: [], greatest: [], middle: [] };
  for (let begin = first - (first % group); begin < last; begin += group) {
    const end = Math.min(begin + group, curve.count);
    let least = Infinity, greatest = -Infinity, sum = 0;
    for (let k = begin; k < end; k++) {
      if (curve.least[k] < least) least = curve.least[k];
      if (curve.greatest[k] > greatest) greatest = curve.greatest[k];
      sum += curve.scale === "log" ? curve.middle[k] ** 2 : curve.middle[k]; // NaN stays: the line breaks
    }
    merged.t.push(curve.start + ((begin + end) / 2) * curve.step);
    merged.least.push(least === Infinity ? NaN : least);
    merged.greatest.push(greatest === -Infinity ? NaN : greatest);
    merged.middle.push(curve.scale === "log" ? Math.sqrt(sum / (end - begin)) : sum / (end - begin));
  }
  return merged;
}

// --- plots

const DASHES = ["solid", "dashed", "dotted"];
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

class TimePlots {
  // Stacked plots over one time axis; show() draws the curves of one recording.
  constructor(target, panels, series) {
    const narrow = target.clientWidth < 600;
    this.panels = panels;
    this.series = series;
    this.range = new Bokeh.Range1d({ start: 0, end: 1 });
    this.rests = new Bokeh.ColumnDataSource({ data: { start: [], end: [] } });
    const cursor = new Bokeh.Span({ dimension: "height", line_dash: "dotted" });
    this.cursor = cursor;
    this.figures = panels.map((panel) => this.makeFigure(panel, cursor, narrow));
    const children = this.figures.map((one) => one.figure);
    Bokeh.Plotting.show(new Bokeh.Column({ children, sizing_mode: "stretch_width" }), target);
    let pending = null;
    this.range.change.connect(() => {
      clearTimeout(pending);
      pending = setTimeout(() => this.refine(), 30);
    });
  }

  makeFigure(panel, cursor, narrow) {
    const yRange = new Bokeh.Range1d({ start: 0.1, end: 1 });
    const zoom = new Bokeh.BoxZoomTool({ dimensions: "width" });
    const wheel = new Bokeh.WheelZoomTool({ dimensions: "width", modifiers: { shift: true } });
    const tools = [zoom, new Bokeh.PanTool({ dimensions: "width" }), wheel, new Bokeh.ResetTool()];
    const figure = Bokeh.Plotting.figure({
      title: `${panel.title} (${panel.unit})`,
      height: panel.height,
      sizing_mode: "stretch_width",
      x_range: this.range,
      y_range: yRange,
      y_axis_type: panel.scale,
      tools,
      toolbar_location: "above",
      output_backend: "canvas",
      min_border_left: narrow ? 40 : 60,
    });
    figure.toolbar.active_drag = narrow ? null : zoom; // on a phone a finger scrolls the page
    figure.toolbar.logo = null;
    figure.vstrip({ field: "start" }, { field: "end" }, { source: this.rests, color: "gray", alpha: 0.16, line_color: null });
    const makeSource = () =>
      new Bokeh.ColumnDataSource({ data: { t: [], least: [], greatest: [], middle: [], upper: [], lower: [] } });
    const judge = { source: makeSource() };
    if (panel.judge === "line") judge.line = figure.line({ field: "t" }, { field: "middle" }, { source: judge.source, line_width: 2.4 });
    else judge.band = figure.varea({ field: "t" }, { field: "lower" }, { field: "upper" }, { source: judge.source, fill_color: "gray", fill_alpha: 0.3 });
    if (judge.line) judge.line.name = "judge";
    const drawn = this.series.map((name, k) => {
      const source = makeSource();
      const band = figure.varea({ field: "t" }, { field: "least" }, { field: "greatest" }, { source, fill_alpha: 0.22 });
      const line_dash = DASHES[Math.floor(k / 8) % 3];
      const line = figure.line({ field: "t" }, { field: "middle" }, { source, line_width: 1.6, line_dash });
      const sides = ["upper", "lower"].map((side) =>
        figure.line({ field: "t" }, { field: side }, { source, line_dash: [4, 4] }));
      line.name = name;
      return { source, band, line, sides };
    });
    const lines = drawn.map((one) => one.line);
    figure.add_tools(
      new Bokeh.CrosshairTool({ overlay: cursor, dimensions: "height" }),
      new Bokeh.HoverTool({
        renderers: judge.line ? [...lines, judge.line] : lines,
        mode: "vline",
        line_policy: "nearest",
        tooltips: "<b>$name</b> @middle{0.000} (@least{0.000} … @greatest{0.000}) at @t{0.00} s",
      }),
    );
    if (panel.scale === "log") labelLogAxis(figure.left[0], "0.[0000]");
    return { panel, figure, judge, drawn, yRange };
  }

  show(recording) {
    // `recording` is an entry of the page's data; its curves are decoded once.
    recording.decoded ??= Object.fromEntries(
      Object.entries(recording.curves).map(([key, curves]) => [
        key,
        Object.fromEntries(Object.entries(curves).map(([name, curve]) => [name, decodeCurve(curve)])),
      ]),
    );
    this.recording = recording;
    this.rests.data = { start: recording.rests.map((rest) => rest[0]), end: recording.rests.map((rest) => rest[1]) };
    [this.range.start, this.range.end] = recording.span;
    for (const { figure } of this.figures) figure.visible = true;
    this.refine();
  }

  refine() {
    if (!this.recording) return;
    const { start, end } = this.range;
    const most = Math.max(200, Math.round(document.body.clientWidth / 1.5));
    for (const { panel, judge, drawn, yRange } of this.figures) {
      const curves = this.recording.decoded[panel.key] ?? {}, sds = this.recording.decoded[`${panel.key}:sd`] ?? {};
      const fill = (source, curve, sd) => {
        const data = curve ? mergeColumns(curve, start, end, most) : { t: [], least: [], greatest: [], middle: [] };
        const around = sd ? mergeColumns(sd, start, end, most) : null;
        if (!curve && around) Object.assign(data, around);
        data.upper = around ? around.greatest : data.t.map(() => NaN);
        data.lower = around ? around.greatest.map((value) => (panel.scale === "log" ? 1e-4 : -value)) : data.t.map(() => NaN);
        if (data.upper.length !== data.t.length) data.upper = data.lower = data.t.map(() => NaN);
        source.data = data;
      };
      fill(judge.source, curves.judge, sds.judge);
      drawn.forEach((one, k) => fill(one.source, curves[this.series[k]], sds[this.series[k]]));
      const seen = drawn.filter((one) => one.line.visible).map((one) => one.source.data);
      if (judge.line) seen.push(judge.source.data);
      yRange.setv(spanOf(seen, panel.scale));
    }
  }

  setVisible(shown) {
    // `shown` holds a Boolean for each series.
    for (const { drawn } of this.figures)
      drawn.forEach((one, k) => {
        for (const part of [one.band, one.line, ...one.sides]) part.visible = shown[k];
      });
    this.refine();
  }

  zoom(factor, shift) {
    // Scale the shown stretch about its middle, then move it by a share of its length; within the recording.
    const [first, last] = this.recording.span;
    const length = Math.min((this.range.end - this.range.start) * factor, last - first);
    const middle = (this.range.start + this.range.end) / 2 + shift * length;
    const start = Math.min(Math.max(middle - length / 2, first), last - length);
    this.range.setv({ start, end: start + length });
  }

  recolour() {
    this.cursor.line_color = css("--soft");
    for (const { figure, judge, drawn } of this.figures) {
      recolourFigure(figure);
      if (judge.line) judge.line.glyph.line_color = css("--ink");
      drawn.forEach((one, k) => {
        const colour = css(`--line-${k % 8}`);
        one.band.glyph.fill_color = colour;
        for (const line of [one.line, ...one.sides]) line.glyph.line_color = colour;
      });
    }
  }
}

function spanOf(columns, scale) {
  // The axis from below the lowest line (log: bands dip towards 0 and are cut) or band to above the highest band.
  let low = Infinity, high = -Infinity;
  for (const data of columns) {
    for (const value of scale === "log" ? data.middle : data.least) if (value < low) low = value;
    for (const value of data.greatest) if (value > high) high = value;
  }
  if (low > high) return { start: 0.1, end: 1 };
  if (scale === "log") return { start: low / 2, end: high * 1.3 };
  const margin = 0.06 * (high - low) || 0.5;
  return { start: low - margin, end: high + margin };
}

function labelLogAxis(axis, format) {
  axis.ticker.setv({ mantissas: [1, 2, 5], desired_num_ticks: 4 });
  axis.formatter = new Bokeh.NumeralTickFormatter({ format });
}

function recolourFigure(figure) {
  const ink = css("--ink"), soft = css("--soft"), grid = css("--grid");
  figure.setv({ background_fill_color: css("--paper"), border_fill_color: css("--paper"), outline_line_color: grid });
  figure.title.setv({ text_color: ink, text_font: "sans-serif", text_font_size: "14px" });
  for (const axis of [...figure.below, ...figure.left])
    if (axis.major_label_text_color !== undefined)
      axis.setv({
        major_label_text_color: soft, axis_label_text_color: soft, axis_line_color: grid,
        major_tick_line_color: grid, minor_tick_line_color: null, axis_label_text_font_style: "normal",
      });
  for (const line of figure.center) if (line.grid_line_color !== undefined) line.grid_line_color = grid;
}

const LABEL_PX = 14, DOT_PX = 6; // height of a name, radius of a dot

function placeLabels(dots, widths, width, height) {
  // A place beside its dot for each name, in px from the dot, so that no name covers a dot, a name or the frame.
  // `dots` are [x, y] in px. Places near the dot come first; a name that fits nowhere gets the place of least overlap.
  const taken = dots.map(([x, y]) => [x - DOT_PX, y - DOT_PX, x + DOT_PX, y + DOT_PX]);
  const overlap = (a, b) =>
    Math.max(0, Math.min(a[2], b[2]) - Math.max(a[0], b[0])) * Math.max(0, Math.min(a[3], b[3]) - Math.max(a[1], b[1]));
  const places = [];
  for (const far of [0, 14, 28, 44, 62])
    for (const [side, up] of [[1, 0], [-1, 0], [1, -1], [1, 1], [-1, -1], [-1, 1], [0, -1], [0, 1]]) places.push([side, up, far]);
  const order = dots.map((_, k) => k).sort((a, b) => dots[a][0] - dots[b][0]);
  const found = [];
  for (const k of order) {
    const [x, y] = dots[k];
    let best = null;
    for (const [side, up, far] of places) {
      const left = x + side * (DOT_PX + 3 + (up ? far / 2 : far)) - (side < 0 ? widths[k] : side ? 0 : widths[k] / 2);
      const middle = y + up * (DOT_PX + 4 + far + LABEL_PX / 2 - (side ? LABEL_PX / 2 : 0));
      const box = [left, middle - LABEL_PX / 2, left + widths[k], middle + LABEL_PX / 2];
      const outside = widths[k] * LABEL_PX - overlap(box, [0, 0, width, height]);
      const cost = outside + taken.reduce((sum, other) => sum + overlap(box, other), 0);
      if (!best || cost < best.cost) best = { cost, box, far };
      if (cost === 0) break;
    }
    taken.push(best.box);
    found[k] = { x: best.box[0] - x, y: (best.box[1] + best.box[3]) / 2 - y, width: widths[k], far: best.far };
  }
  return found;
}

class CostPlot {
  // Typical error against time per sample.
  constructor(target, points) {
    const least = (key) => Math.min(...points.map((one) => one[key]));
    const greatest = (key) => Math.max(...points.map((one) => one[key]));
    this.points = points;
    this.source = new Bokeh.ColumnDataSource({ data: {
      name: points.map((one) => one.name), cost: points.map((one) => one.cost), error: points.map((one) => one.error),
      x: points.map(() => 0), y: points.map(() => 0),
    } });
    this.leads = new Bokeh.ColumnDataSource({ data: { cost: [], error: [], cost2: [], error2: [] } });
    this.xRange = new Bokeh.Range1d({ start: least("cost") / 2, end: greatest("cost") * 3 });
    this.yRange = new Bokeh.Range1d({ start: least("error") / 1.5, end: greatest("error") * 1.5 });
    const figure = Bokeh.Plotting.figure({
      height: 440, sizing_mode: "stretch_width", x_axis_type: "log", y_axis_type: "log",
      tools: [new Bokeh.BoxZoomTool(), new Bokeh.PanTool(), new Bokeh.ResetTool()], toolbar_location: "above",
      x_range: this.xRange, y_range: this.yRange,
    });
    figure.toolbar.setv({ logo: null, active_drag: null });
    figure.below[0].axis_label = "time per sample (ns)";
    figure.left[0].axis_label = "typical RMSE (deg)";
    labelLogAxis(figure.below[0], "0,0");
    labelLogAxis(figure.left[0], "0.[000]");
    this.lines = figure.segment({ field: "cost" }, { field: "error" }, { field: "cost2" }, { field: "error2" }, { source: this.leads });
    this.dots = figure.scatter({ field: "cost" }, { field: "error" }, { source: this.source, size: 2 * DOT_PX });
    this.names = figure.text({ field: "cost" }, { field: "error" }, { field: "name" }, {
      source: this.source, x_offset: { field: "x" }, y_offset: { field: "y" }, text_baseline: "middle", text_font_size: "12px",
    });
    figure.add_tools(new Bokeh.HoverTool({ renderers: [this.dots], tooltips: "<b>@name</b> @error{0.000} deg, @cost{0,0} ns per sample" }));
    this.figure = figure;
    Bokeh.Plotting.show(figure, target);
    let pending = null;
    const later = () => {
      clearTimeout(pending);
      pending = setTimeout(() => this.place(), 60);
    };
    const sizes = ["inner_width", "inner_height"].map((name) => figure.properties[name]); // known once it is laid out
    for (const { change } of [this.xRange, this.yRange, ...sizes]) change.connect(later);
  }

  place() {
    const { inner_width: width, inner_height: height } = this.figure;
    const scale = (range, size) => (value) => (Math.log(value / range.start) / Math.log(range.end / range.start)) * size;
    const inverse = (range, size) => (px) => range.start * Math.exp((px / size) * Math.log(range.end / range.start));
    const toX = scale(this.xRange, width), toY = scale(this.yRange, height);
    const pen = document.createElement("canvas").getContext("2d");
    pen.font = "12px sans-serif";
    const dots = this.points.map((one) => [toX(one.cost), height - toY(one.error)]);
    this.places = placeLabels(dots, this.points.map((one) => pen.measureText(one.name).width + 4), width, height);
    this.source.data = { ...this.source.data, x: this.places.map((one) => one.x + 2), y: this.places.map((one) => one.y) };
    const fromX = inverse(this.xRange, width), fromY = inverse(this.yRange, height), leads = { cost: [], error: [], cost2: [], error2: [] };
    this.places.forEach((one, k) => {
      if (!one.far) return;
      const end = Math.min(Math.max(0, one.x), one.x + one.width); // the end of the name that is nearer to its dot
      leads.cost.push(this.points[k].cost);
      leads.error.push(this.points[k].error);
      leads.cost2.push(fromX(dots[k][0] + end));
      leads.error2.push(fromY(height - dots[k][1] - one.y));
    });
    this.leads.data = leads;
  }

  recolour() {
    recolourFigure(this.figure);
    this.dots.glyph.setv({ fill_color: css("--line-0"), line_color: null });
    this.lines.glyph.line_color = css("--soft");
    this.names.glyph.text_color = css("--ink");
  }
}

// --- the page

function startPage() {
  for (const button of document.querySelectorAll("th button.sort")) button.addEventListener("click", () => sortTable(button));
  for (const field of document.querySelectorAll("input[data-table]")) field.addEventListener("input", () => filterTable(field));
  const holder = document.getElementById("page-data");
  if (!holder) return;
  const data = JSON.parse(holder.textContent), drawn = [];
  const costs = document.getElementById("cost-plot");
  if (costs) drawn.push(new CostPlot(costs, data.costs));
  const target = document.getElementById("time-plots");
  if (target) drawn.push(connectTimePlots(new TimePlots(target, data.panels, data.series), data));
  const recolour = () => drawn.forEach((one) => one.recolour());
  recolour();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolour);
  window.stillpointPlots = drawn; // for tests and for the browser's console
}

function connectTimePlots(plots, data) {
  const choice = document.getElementById("recording-choice"), status = document.getElementById("plots-status");
  const say = () => {
    status.textContent = `${plots.range.start.toFixed(1)} s to ${plots.range.end.toFixed(1)} s`;
  };
  plots.range.change.connect(say);
  const open = (name) => {
    const recording = data.recordings[name];
    if (!recording) return;
    if (choice) choice.value = name;
    plots.show(recording);
    say();
  };
  const [first] = Object.keys(data.recordings);
  const named = () => decodeURIComponent(location.hash.replace(/^#run=/, ""));
  open(location.hash.startsWith("#run=") && data.recordings[named()] ? named() : first);
  choice?.addEventListener("change", () => open(choice.value));
  window.addEventListener("hashchange", () => {
    if (!location.hash.startsWith("#run=")) return;
    open(named());
    document.getElementById("runs").scrollIntoView();
    document.getElementById("runs").focus({ preventScroll: true });
  });
  const boxes = [...document.querySelectorAll("input[data-series]")];
  const showChecked = () => plots.setVisible(boxes.map((box) => box.checked));
  for (const box of boxes) box.addEventListener("change", showChecked);
  for (const button of document.querySelectorAll("button[data-show]"))
    button.addEventListener("click", () => {
      for (const box of boxes) box.checked = button.dataset.show === "all";
      showChecked();
    });
  const showNamed = () => {
    // #estimator=NAME, by which the map of a leaderboard opens a page: this one alone
    const wanted = data.series.indexOf(decodeURIComponent(location.hash.replace(/^#estimator=/, "")));
    if (!location.hash.startsWith("#estimator=") || wanted < 0) return;
    for (const box of boxes) box.checked = Number(box.dataset.series) === wanted;
    showChecked();
    document.getElementById("runs").scrollIntoView();
    document.getElementById("runs").focus({ preventScroll: true });
  };
  window.addEventListener("hashchange", showNamed);
  showChecked();
  showNamed();
  for (const button of document.querySelectorAll("button[data-zoom]"))
    button.addEventListener("click", () => plots.zoom(Number(button.dataset.zoom), Number(button.dataset.shift ?? 0)));
  return plots;
}

startPage();
