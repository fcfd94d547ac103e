// Plots over uplot: colours of the theme, a reading under the pointer, zoom by dragging, keys. The script is loaded with the
// first plot.

import { make } from "/frame.js";
import { fixed } from "/numbers.js";

/** @type {Promise<any> | null} */
let loading = null;

async function library() {
  loading ??= (async () => {
    document.head.append(make("link", null, { rel: "stylesheet", href: "/vendor/uplot.css" }));
    return (await import("/vendor/uplot.js")).UPlot;
  })();
  return loading;
}

/** A colour of the theme by the name of its variable. @param {string} name */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/**
 * @typedef {object} PlotOptions
 * @property {string} label what the plot shows, for those who do not see it
 * @property {string} x label of the axis below
 * @property {string} y label of the axis beside
 * @property {() => any[]} series the series of uplot after that of x, in the colours of the theme
 * @property {any[]} [bands]
 * @property {(at: number | null) => void} [hover] gets the place of the data under the pointer
 * @property {(at: number) => void} [pick] gets the place of the data that is clicked or entered
 * @property {(plot: any) => void} [after] draws on top
 * @property {number} [height]
 * @property {number} [digits] after the point of y
 */

/**
 * A plot in a box, which has a size. Zoom by dragging; a double click shows all. Keys: arrows, Enter, Home.
 * @param {HTMLElement} box
 * @param {PlotOptions} options
 */
export async function plotIn(box, options) {
  const UPlot = await library();
  /** @type {any} */
  let plot = null;
  /** @type {any[][]} */
  let data = [[]];
  let zoomed = false;
  const axis = (label, more = {}) => ({ label, stroke: colour("--soft"), grid: { stroke: colour("--rule"), width: 1 }, ticks: { stroke: colour("--rule") }, ...more });
  const size = () => ({ width: Math.max(200, box.clientWidth), height: options.height ?? 240 });
  function build() {
    plot?.destroy();
    plot = new UPlot(
      {
        ...size(),
        legend: { show: false },
        scales: { x: { time: false } },
        axes: [
          axis(options.x, { values: (_, ticks) => ticks.map((tick) => fixed(tick, Number.isInteger(tick) ? 0 : 1)) }),
          axis(options.y, { size: 70, values: (_, ticks) => ticks.map((tick) => fixed(tick, options.digits ?? 3)) }),
        ],
        series: [{}, ...options.series()],
        bands: options.bands ?? [],
        cursor: { drag: { x: true, y: false } },
        hooks: {
          setCursor: [(own) => options.hover?.(own.cursor.idx ?? null)],
          setSelect: [(own) => (zoomed = own.select.width > 0)],
          draw: options.after ? [options.after] : [],
        },
      },
      data,
      box,
    );
    plot.over.addEventListener("dblclick", () => (zoomed = false));
    let from = 0;
    plot.over.addEventListener("pointerdown", (event) => (from = event.clientX));
    plot.over.addEventListener("pointerup", (event) => {
      // A drag zooms, a click picks.
      if (Math.abs(event.clientX - from) < 4 && plot.cursor.idx !== null) options.pick?.(plot.cursor.idx);
    });
  }
  box.tabIndex = 0;
  box.setAttribute("role", "group");
  box.setAttribute("aria-label", options.label);
  box.addEventListener("keydown", (event) => {
    const at = plot?.cursor.idx ?? -1;
    const count = data[0].length;
    const go = (place) => {
      const next = Math.max(0, Math.min(count - 1, place));
      plot.setCursor({ left: plot.valToPos(data[0][next], "x"), top: 10 });
    };
    const acts = {
      ArrowLeft: () => go(at - 1), ArrowRight: () => go(at + 1), Enter: () => at >= 0 && options.pick?.(at), Home: () => whole(),
    };
    const act = acts[event.key];
    if (!act || !count || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    event.stopPropagation();
    act();
  });
  function whole() {
    zoomed = false;
    plot?.setData(data);
  }
  new ResizeObserver(() => box.clientWidth && plot?.setSize(size())).observe(box);
  window.addEventListener("dbbd:theme", build);
  build();
  return {
    /** Shows data: x, then each series. A zoom stays. @param {any[][]} now */
    show(now) {
      data = now;
      plot.setData(data, !zoomed);
      if (zoomed) plot.redraw();
    },
    /** Shows all. */
    whole,
    /** What is shown. */
    data: () => data,
  };
}
