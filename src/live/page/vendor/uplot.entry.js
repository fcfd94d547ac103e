// What plots.js uses of uplot.
export { default as UPlot } from "uplot";
