//! A quantity against time: values with their 95 % intervals, and the straight line through them.

use super::Series;
use super::frame::WIDE;
use super::frame::{Area, Frame, Labels};
use crate::report::scale::{Unit, range, signed, significant};
use crate::report::svg::Anchor;
use dbbd_model::base::date::days_since_1970;
use dbbd_model::math::straight_line::StraightLine;

/// Most ticks of an axis of dates, and their distances in months.
const MOST_TICKS: f64 = 12.0;
const STEPS: [i64; 8] = [1, 2, 3, 6, 12, 24, 60, 120];
/// Segments of the band about the line.
const BAND: usize = 40;

#[derive(Clone, Copy)]
pub enum Time<'a> {
    /// Numbers, with the name of the axis.
    Numbers(&'a str),
    /// Days since 1970-01-01.
    Dates,
}

/// A value in the quantity's own unit.
#[derive(Clone, Debug, PartialEq)]
pub struct TrendPoint {
    pub time: f64,
    pub value: f64,
    /// Half width of the 95 % interval; 0 if there is none.
    pub u95: f64,
    pub has_warnings: bool,
}

/// The straight line through the values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrendLine {
    pub line: StraightLine,
    /// Half width of its 95 % band in standard deviations, if the band is drawn.
    pub coverage: Option<f64>,
    pub until: f64,
}

pub struct TrendPlot<'a> {
    pub title: &'a str,
    pub size: [f64; 2],
    pub unit: Unit,
    pub time: Time<'a>,
    pub points: &'a [TrendPoint],
    pub line: Option<TrendLine>,
    /// A level that must not be exceeded, in the quantity's own unit.
    pub limit: Option<f64>,
}

impl<'a> TrendPlot<'a> {
    /// A plot of lengths against dates (days since 1970-01-01), across the page.
    pub fn against_dates(
        title: &'a str,
        points: &'a [TrendPoint],
        line: Option<TrendLine>,
        limit: Option<f64>,
    ) -> Self {
        let unit = Unit::length(points.iter().map(|point| point.value.abs()).fold(0.0, f64::max));
        Self { title, size: [WIDE, 300.0], unit, time: Time::Dates, points, line, limit }
    }

    /// The picture; empty without a value.
    pub fn to_svg(&self) -> String {
        if self.points.is_empty() {
            return String::new();
        }
        let factor = self.unit.factor;
        let times = self.points.iter().map(|point| point.time);
        let [first, last] = range(times.chain(self.line.map(|line| line.until)));
        let ends = self.points.iter().flat_map(|point| [point.value - point.u95, point.value + point.u95]);
        let ahead = self.line.map(|line| line.line.at(line.until));
        let [low, high] = range(ends.chain(self.limit).chain(ahead).map(|value| value * factor));
        let (pad, wide) = (0.08 * (high - low), 0.05 * (last - first));
        let labels = Labels {
            title: self.title,
            description: "Values with their 95 % intervals against time",
            x: match self.time {
                Time::Numbers(name) => name,
                Time::Dates => "",
            },
            y: &format!("({})", self.unit.sign),
        };
        let (x, y) = ([first - wide, last + wide], [low - pad, high + pad]);
        let mut frame = Frame::new(Area::of(self.size), &labels, x, y);
        match self.time {
            Time::Numbers(_) => frame.axes(),
            Time::Dates => dates(&mut frame),
        }
        if let Some(line) = self.line {
            draw(&mut frame, line, [first, factor]);
        }
        if let Some(limit) = self.limit {
            frame.level("limit", limit * factor);
        }
        for &TrendPoint { time, value, u95, has_warnings } in self.points {
            let [bottom, top] = [-u95, u95].map(|off| frame.at(time, (value + off) * factor));
            let mut tip = signed(value * factor, 4);
            if u95 > 0.0 {
                frame.svg.line("l-bar", bottom, top);
                tip += &format!(" ± {}", significant(u95 * factor, 2));
            }
            let series = if has_warnings { Series::First } else { Series::Second };
            let tip = format!("{tip} {}", self.unit.sign);
            frame.svg.circle(series.dot(), frame.at(time, value * factor), 3.0, &tip);
        }
        frame.svg.finish()
    }
}

/// The line with its 95 % band.
fn draw(frame: &mut Frame, TrendLine { line, coverage, until }: TrendLine, [first, factor]: [f64; 2]) {
    let at = |part: usize| first + (until - first) * part as f64 / BAND as f64;
    for sign in [-1.0, 1.0] {
        let Some(coverage) = coverage else { continue };
        let edge = |day: f64| {
            let sd = line.level_sd.hypot(line.slope_sd * (day - line.centre));
            frame.inside(day, (line.at(day) + sign * coverage * sd) * factor)
        };
        let points: Vec<[f64; 2]> = (0..=BAND).map(|part| edge(at(part))).collect();
        frame.svg.path("margin", &points, false);
    }
    let [from, to] = [first, until].map(|day| frame.at(day, line.at(day) * factor));
    frame.svg.line(Series::Third.line(), from, to);
}

/// Draws the axes of a plot against dates: a mark at the first day of every few months.
fn dates(frame: &mut Frame) {
    frame.y_axis_lines();
    let [first, last] = frame.x.values;
    let year = 1970 + (first / 365.2425).floor() as i64 - 1;
    let months = (last - first) / 30.4;
    let step = STEPS.into_iter().find(|step| months / *step as f64 <= MOST_TICKS).unwrap_or(240);
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
