// node --test tests/page
import assert from "node:assert/strict";
import { test } from "node:test";

import { parseNumber } from "../../src/live/page/number_text.js";

/** @param {import("../../src/live/page/number_text.js").NumberField} field @param {[string, any][]} rows text, and its value or the key of the reason */
function rows(field, rows) {
  for (const [text, wanted] of rows) {
    const found = parseNumber(text, field);
    const expected = typeof wanted === "string" ? { reason: wanted } : { value: wanted };
    assert.deepEqual(found, expected, JSON.stringify(text));
  }
}

test("a number has a point or a comma, a sign and an exponent", () => {
  rows({ unit: "" }, [
    ["0", 0],
    ["12", 12],
    ["12.5", 12.5],
    ["12,5", 12.5],
    [".5", 0.5],
    [",5", 0.5],
    ["+7", 7],
    ["-7", -7],
    ["−7,25", -7.25],
    ["-0", 0],
    ["−0,0", 0],
    ["  3 ", 3],
    ["\t3\u00a0", 3],
    ["\u202f3", 3],
    ["007", 7],
    ["1e-3", 0.001],
    ["1,5E3", 1500],
    ["2e+2", 200],
    ["2e−2", 0.02],
    ["0e400", 0],
    ["0.1", 0.1],
    ["1300.05", 1300.05],
    ["9007199254740993", 9007199254740992],
  ]);
});

test("a unit that fits is converted, and changes no digit", () => {
  rows({ unit: "mm" }, [
    ["0.5 mm", 0.5],
    ["0,5mm", 0.5],
    ["0.5\u00a0mm", 0.5],
    ["500 µm", 0.5],
    ["500 μm", 0.5],
    ["500 um", 0.5],
    ["500um", 0.5],
    ["0.1 cm", 1],
    ["0.3 m", 300],
    ["1.005 m", 1005],
    ["1.1e3 µm", 1.1],
    ["-2 cm", -20],
  ]);
  rows({ unit: "µm" }, [["2", 2], ["2 µm", 2], ["2 um", 2], ["0.002 mm", 2], ["0.0021 mm", 2.1], ["2 cm", "wrong.unit"], ["2 m", "wrong.unit"]]);
  rows({ unit: "°" }, [["-18", -18], ["90°", 90], ["90 °", 90], ["90 deg", 90], ["90deg", 90], ["90 °C", "wrong.unit"], ["1 rad", "wrong.unit"]]);
  rows({ unit: "°C" }, [["20", 20], ["20 °C", 20], ["20C", 20], ["-5 C", -5], ["20 °", "wrong.unit"], ["293 K", "wrong.unit"], ["68 F", "wrong.unit"]]);
  rows({ unit: "1/K" }, [
    ["1.2e-5", 1.2e-5],
    ["12e-6 1/K", 12e-6],
    ["12e-6 /K", 12e-6],
    ["12e-6/K", 12e-6],
    ["0,000012 1/K", 12e-6],
    ["12e-61/K", "wrong.ambiguous"],
    ["0.0000121/K", "wrong.ambiguous"],
    ["1/K", "wrong.ambiguous"],
    ["12 ppm/K", "wrong.unit"],
    ["12e-6 K", "wrong.unit"],
  ]);
});

test("a unit that does not fit is refused", () => {
  rows({ unit: "mm" }, [
    ["0.5 °", "wrong.unit"],
    ["0.5 km", "wrong.unit"],
    ["0.5 in", "wrong.unit"],
    ["0.5 MM", "wrong.unit"],
    ["0.5 Mm", "wrong.unit"],
    ["0.5 mm mm", "wrong.unit"],
    ["0.5 mm2", "wrong.unit"],
    ["0.5 constructor", "wrong.unit"],
    ["0.5 __proto__", "wrong.number"],
    ["0.5 toString", "wrong.unit"],
    ["1e", "wrong.unit"],
    ["1e3e3", "wrong.unit"],
    ["0x1F", "wrong.unit"],
    ["1/2", "wrong.unit"],
    ["1n", "wrong.unit"],
  ]);
  rows({ unit: "" }, [["40 mm", "wrong.no_unit"], ["40 points", "wrong.no_unit"], ["0b11", "wrong.no_unit"]]);
});

test("a thousands separator, or two numbers, can be read in two ways", () => {
  const texts = ["1,234.5", "1.234,5", "1.234.567", "1,234,567", "1 234", "1\u00a0234,5", "1\u202f234", "1'234", "1’234", "1.2.3", "1 2", "1e3.5", "1.5 2.5 mm"];
  rows({ unit: "mm" }, texts.map((text) => [text, "wrong.ambiguous"]));
});

test("what is no number is refused and becomes nothing else", () => {
  const texts = [
    "abc", "NaN", "Infinity", "-Infinity", "∞", "1e400", "-1e400", "1e-400", "9".repeat(400), "1e99999999999999999999", "1e-99999999999999999999",
    "--5", "+-5", "− −5", "- 5", "+", "-", ".", ",", "e5", "mm", "mm 5", "null", "undefined", "true", "[]", "{}", "()", "٣", "５", "½", "\u200b5", "5.", "5,", "5-", "1,,2", "1_000", "5 %",
    "<b>1</b>", "'5'", "=5", "$5", "~5", "#5", "%5", "\u0000",
  ];
  for (const optional of [false, true]) rows({ unit: "mm", optional }, texts.map((text) => [text, "wrong.number"]));
  // The conversion may make it too large or nothing.
  rows({ unit: "mm" }, [["1e307 m", "wrong.number"], ["5e-324 µm", "wrong.number"]]);
});

test("an empty field is null where it may be empty", () => {
  rows({ unit: "mm", optional: true }, [["", null], ["  ", null], ["\u00a0", null], ["0", 0]]);
  rows({ unit: "mm" }, [["", "wrong.missing"], ["  ", "wrong.missing"]]);
});

test("a range is that of the field's unit", () => {
  const range = { low: 0, high: 20, aboveLow: true };
  rows({ unit: "mm", optional: true, range }, [
    ["0.5 mm", 0.5],
    ["500 µm", 0.5],
    ["20", 20],
    ["2 cm", 20],
    ["1e-9", 1e-9],
    ["", null],
    ["0", "wrong.range_above"],
    ["-0", "wrong.range_above"],
    ["0 mm", "wrong.range_above"],
    ["-1", "wrong.range_above"],
    ["20.0001", "wrong.range_above"],
    ["500", "wrong.range_above"],
    ["0.5 m", "wrong.range_above"],
    ["0.5 kg", "wrong.unit"],
  ]);
  rows({ unit: "mm", range: { low: -5, high: 5 } }, [["-5", -5], ["5", 5], ["-5.001", "wrong.range"], ["6", "wrong.range"]]);
});

test("a list has its count of numbers, each read as one", () => {
  const six = [0, -90, 90, 0, 45.5, 180];
  rows({ unit: "°", count: 6, optional: true }, [
    ["0; -90; 90; 0; 45,5; 180", six],
    ["0;−90;90;0;45.5;180", six],
    ["  0 -90  90\t0 45.5 180 ", six],
    ["0° -90° 90° 0° 45.5° 180°", six],
    ["0 deg; -90 deg; 90 deg; 0; 45.5; 180 deg", six],
    ["", null],
    ["0 -90 90 0 45.5", "wrong.count"],
    ["0;-90;90;0;45.5;180;", "wrong.count"],
    ["0; -90; 90; 0; 45.5; 180; 0", "wrong.count"],
    ["0; -90; ; 0; 45.5; 180", "wrong.number"],
    ["0; -90; x; 0; 45.5; 180", "wrong.number"],
    ["0, -90, 90, 0, 45.5, 180", "wrong.number"],
    ["0; -90; 1,234.5; 0; 45.5; 180", "wrong.ambiguous"],
    ["0; -90; 90 mm; 0; 45.5; 180", "wrong.unit"],
  ]);
});

test("a field for whole numbers takes no part of one, and no field a number beyond what a message shows", () => {
  rows({ unit: "", whole: true }, [["12", 12], ["12.0", 12], ["1e2", 100], ["12.5", "wrong.whole"], ["0,5", "wrong.whole"], ["-3", -3]]);
  rows({ unit: "", whole: true, range: { low: 3, high: 255 } }, [["3", 3], ["255", 255], ["2", "wrong.range"], ["-3", "wrong.range"], ["40.5", "wrong.whole"]]);
  rows({ unit: "mm" }, [["1e305", "wrong.large"], ["-1e16", "wrong.large"], ["1e13 m", "wrong.large"], ["1e15", 1e15]]);
});
