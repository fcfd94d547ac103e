//! A quantity against the date: values, the straight line through them, and where it leads.

use super::Series;
use super::frame::{Area, Frame, Labels, WIDE};
use crate::base::date::days_since_1970;
use crate::math::straight_line::StraightLine;
use crate::report::scale::{Unit, range, signed};
use crate::report::svg::Anchor;

const HEIGHT: f64 = 300.0;
/// Ticks of the dates: at most so many, at these distances in months.
const MOST_TICKS: usize = 12;
const STEPS: [i64; 8] = [1, 2, 3, 6, 12, 24, 60, 120];
/// Points of the band about the line.
const BAND: usize = 40;

/// A value and when it was found.
#[derive(Clone, Debug, PartialEq)]
pub struct DriftPoint {
    /// Days since 1970-01-01.
    pub day: f64,
    /// mm.
    pub value: f64,
    /// Half width of its 95 % interval, mm; 0 where it has none.
    pub u95: f64,
    pub doubtful: bool,
}

/// The straight line through the values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriftLine {
    /// mm over days since 1970-01-01.
    pub line: StraightLine,
    /// Half width of a 95 % interval in its standard deviations.
    pub coverage: f64,
    /// The day to which it is drawn.
    pub until: f64,
}

/// The values of a quantity at their dates.
pub struct Drift<'a> {
    pub title: &'a str,
    pub points: &'a [DriftPoint],
    pub line: Option<DriftLine>,
    /// A level that must not be exceeded, mm.
    pub limit: Option<f64>,
}

impl Drift<'_> {
    /// The picture; empty where there is no value.
    pub fn to_svg(&self) -> String {
        if self.points.is_empty() {
            return String::new();
        }
        let unit = Unit::length(self.points.iter().map(|point| point.value.abs()).fold(0.0, f64::max));
        let factor = unit.factor;
        let days = self.points.iter().map(|point| point.day).chain(self.line.map(|line| line.until));
        let [first, last] = range(days);
        let ends = self.points.iter().flat_map(|point| [point.value - point.u95, point.value + point.u95]);
        let ahead = self.line.map(|line| line.line.at(line.until));
        let [low, high] = range(ends.chain(self.limit).chain(ahead).map(|value| value * factor));
        let (pad, wide) = (0.08 * (high - low), (0.02 * (last - first)).max(1.0));
        let labels = Labels {
            title: self.title,
            description: "Values against the date, with the straight line through them",
            x: "",
            y: &format!("({})", unit.sign),
        };
        let area = Area::of([WIDE, HEIGHT]);
        let mut frame = Frame::new(area, &labels, [first - wide, last + wide], [low - pad, high + pad]);
        frame.y_axis_lines();
        dates(&mut frame, [first, last]);
        if let Some(line) = self.line {
            draw(&mut frame, line, [first, factor]);
        }
        if let Some(limit) = self.limit {
            frame.level("limit", limit * factor);
        }
        for point in self.points {
            let at = |value: f64| frame.at(point.day, value * factor);
            let (bottom, top, centre) =
                (at(point.value - point.u95), at(point.value + point.u95), at(point.value));
            if point.u95 > 0.0 {
                frame.svg.line("l-bar", bottom, top);
            }
            let series = if point.doubtful { Series::First } else { Series::Second };
            let tip = format!("{} {}", signed(point.value * factor, 1), unit.sign);
            frame.svg.circle(series.dot(), centre, 3.0, &tip);
        }
        frame.svg.finish()
    }
}

/// The line with its 95 % band.
fn draw(frame: &mut Frame, DriftLine { line, coverage, until }: DriftLine, [first, factor]: [f64; 2]) {
    let at = |part: usize| first + (until - first) * part as f64 / BAND as f64;
    let edge = |sign: f64| {
        let value = move |day: f64| {
            let sd = line.level_sd.hypot(line.slope_sd * (day - line.centre));
            (line.at(day) + sign * coverage * sd) * factor
        };
        (0..=BAND).map(move |part| (at(part), value(at(part))))
    };
    for sign in [-1.0, 1.0] {
        let points: Vec<[f64; 2]> = edge(sign).map(|(day, value)| frame.inside(day, value)).collect();
        frame.svg.path("margin", &points, false);
    }
    let [from, to] = [first, until].map(|day| frame.at(day, line.at(day) * factor));
    frame.svg.line(Series::Third.line(), from, to);
}

/// A mark at the first of every so many months.
fn dates(frame: &mut Frame, [first, last]: [f64; 2]) {
    let year = 1970 + (first / 365.2425).floor() as i64 - 1;
    let months = (last - first) / 30.4;
    let step = STEPS.into_iter().find(|step| months / *step as f64 <= MOST_TICKS as f64).unwrap_or(240);
    let firsts = (0..).map(|at| at * step).map(|month| (year + month / 12, month % 12 + 1));
    let firsts = firsts.map(|(year, month)| (year, month, days_since_1970(year, month, 1) as f64));
    let within = firsts.skip_while(|(.., day)| *day < first).take_while(|(.., day)| *day <= last);
    let [left, right] = frame.x.pixels;
    let bottom = frame.y.pixels[0];
    frame.svg.line("rule", [left, bottom], [right, bottom]);
    for (year, month, day) in within {
        let x = frame.x.at(day);
        frame.svg.line("rule", [x, bottom], [x, bottom + 4.0]);
        frame.svg.text("soft", [x, bottom + 17.0], Anchor::Middle, &format!("{year}-{month:02}"));
    }
}
