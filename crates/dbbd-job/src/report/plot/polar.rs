//! The polar plot of a circular test: radial deviation against the angle on the circle, magnified.

use super::frame::NARROW;
use super::{Key, Legend, Series};
use crate::report::scale::{Unit, decimals, magnitude, plain, rounded, signed, significant, step};
use crate::report::svg::{Anchor, Svg};

const HEIGHT: f64 = 500.0;
const CENTRE: [f64; 2] = [240.0, 258.0];
/// Radius of the outermost ring and of the ring of no deviation, pixels.
const OUTER: f64 = 192.0;
const ZERO: f64 = 108.0;
/// Neighbours farther apart than this are not joined, degrees.
const GAP_DEG: f64 = 40.0;
/// With more points than this the dots would hide the line.
const MOST_DOTS: usize = 400;
/// Marks closer together than this share a label, degrees.
const APART_DEG: f64 = 6.0;
/// Half width of the label at each quarter, degrees.
const NAME_DEG: f64 = 8.0;

/// A polar plot of radial deviations.
#[derive(Clone, Debug, PartialEq)]
pub struct PolarPlot {
    pub title: String,
    /// Nominal radius, mm, from which the magnification is computed.
    pub radius_mm: Option<f64>,
    pub traces: Vec<PolarTrace>,
    /// Ticks on the outermost ring: angle (degrees) and label.
    pub marks: Vec<(f64, String)>,
}

/// One trace: a direction, or the state before or after.
#[derive(Clone, Debug, PartialEq)]
pub struct PolarTrace {
    pub name: String,
    pub series: Series,
    /// Angle on the circle (degrees) and deviation (mm, outward positive), in any order.
    pub points: Vec<[f64; 2]>,
}

/// The rings about the ring of zero deviation.
struct Rings {
    unit: Unit,
    /// Distance between two rings, in the unit.
    spacing: f64,
    /// Number of rings on each side.
    count: i32,
    px_per_unit: f64,
}

impl Rings {
    fn of(traces: &[PolarTrace]) -> Self {
        let deviations = traces.iter().flat_map(|trace| trace.points.iter().map(|point| point[1]));
        let largest_mm = magnitude(deviations);
        let unit = Unit::length(largest_mm);
        let spacing = step(largest_mm * unit.factor, 2.5);
        let count = (largest_mm * unit.factor / spacing - 1e-9).ceil().clamp(1.0, 4.0);
        Self { unit, spacing, count: count as i32, px_per_unit: (OUTER - ZERO) / (count * spacing) }
    }

    /// The radius of a deviation (in the unit), pixels.
    fn radius(&self, deviation: f64) -> f64 {
        ZERO + deviation * self.px_per_unit
    }

    /// The deviation of each ring, in the unit.
    fn values(&self) -> impl Iterator<Item = f64> {
        let spacing = self.spacing;
        (-self.count..=self.count).map(move |number| f64::from(number) * spacing)
    }

    /// The scale in words.
    fn note(&self, radius_mm: Option<f64>) -> String {
        let spacing = format!("ring spacing {} {}", significant(self.spacing, 1), self.unit.sign);
        match radius_mm {
            Some(radius) if radius.is_finite() && radius > 0.0 => {
                let magnification = rounded(self.px_per_unit * self.unit.factor * radius / ZERO, 2);
                format!("{spacing}; radius {} mm, deviation magnified {magnification} ×", plain(radius, 3))
            }
            _ => spacing,
        }
    }
}

impl PolarPlot {
    pub fn to_svg(&self) -> String {
        let rings = Rings::of(&self.traces);
        let note = rings.note(self.radius_mm);
        let mut svg = Svg::new(NARROW, HEIGHT, &self.title, &note);
        svg.text("head", [4.0, 16.0], Anchor::Start, &self.title);
        let mut legend = Legend::new(36.0);
        for trace in &self.traces {
            legend.add(&mut svg, Key::Dot(trace.series), &trace.name);
        }
        spokes(&mut svg);
        for value in rings.values() {
            svg.circle(if value == 0.0 { "zero" } else { "grid" }, CENTRE, rings.radius(value), "");
        }
        for trace in &self.traces {
            trace.draw(&mut svg, &rings);
        }
        mark(&mut svg, &self.marks);
        ring_labels(&mut svg, &rings);
        svg.text("soft", [0.5 * NARROW, HEIGHT - 6.0], Anchor::Middle, &note);
        svg.finish()
    }
}

impl PolarTrace {
    /// Draws lines between neighbours, and a dot for each point.
    fn draw(&self, svg: &mut Svg, rings: &Rings) {
        let mut points: Vec<[f64; 2]> = self
            .points
            .iter()
            .filter(|point| point.iter().all(|value| value.is_finite()))
            .map(|&[angle, deviation]| [angle.rem_euclid(360.0), deviation * rings.unit.factor])
            .collect();
        points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let place = |&[angle, deviation]: &[f64; 2]| polar(angle, rings.radius(deviation).max(0.0));
        // Under dots the line is pale.
        let dots = points.len() <= MOST_DOTS;
        let class = format!("{}{}", self.series.line(), if dots { " web" } else { "" });
        let near = |from: &[f64; 2], to: &[f64; 2]| to[0] - from[0] <= GAP_DEG;
        let mut arcs: Vec<Vec<[f64; 2]>> =
            points.chunk_by(near).map(|arc| arc.iter().map(place).collect()).collect();
        let round = points.first().zip(points.last()).is_some_and(|(a, b)| a[0] + 360.0 - b[0] <= GAP_DEG);
        let closed = round && arcs.len() == 1;
        if round
            && !closed
            && let (Some(first), Some(last)) = (points.first(), arcs.last_mut())
        {
            last.push(place(first));
        }
        for arc in &arcs {
            svg.path(&class, arc, closed);
        }
        if !dots {
            return;
        }
        let digits = decimals(rings.spacing) + 1;
        for point in &points {
            let value = signed(point[1], digits);
            let tip = format!("{}: {}°, {value} {}", self.name, signed(point[0], 1), rings.unit.sign);
            svg.circle(self.series.dot(), place(point), 2.4, &tip);
        }
    }
}

/// Draws a spoke each 30 degrees, with a name each 90 degrees.
fn spokes(svg: &mut Svg) {
    for number in 0..12 {
        svg.line("grid", CENTRE, polar(f64::from(number) * 30.0, OUTER));
    }
    let names = [
        (0.0, Anchor::Start, 4.0),
        (90.0, Anchor::Middle, -2.0),
        (180.0, Anchor::End, 4.0),
        (270.0, Anchor::Middle, 10.0),
    ];
    for (angle, anchor, drop) in names {
        let [x, y] = polar(angle, OUTER + 6.0);
        svg.text("soft", [x, y + drop], anchor, &format!("{angle}°"));
    }
}

fn ring_labels(svg: &mut Svg, rings: &Rings) {
    let digits = decimals(rings.spacing);
    let outermost = f64::from(rings.count) * rings.spacing;
    for value in rings.values() {
        let [x, y] = polar(67.5, rings.radius(value));
        let sign = if value == outermost { rings.unit.sign } else { "" };
        let label = format!("{} {sign}", signed(value, digits));
        svg.text("halo", [x, y + 4.0], Anchor::Middle, label.trim_end());
    }
}

/// Draws ticks across the outermost ring, with their labels outside.
fn mark(svg: &mut Svg, marks: &[(f64, String)]) {
    let mut sorted: Vec<(f64, &str)> =
        marks.iter().map(|(angle, word)| (angle.rem_euclid(360.0), word.as_str())).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(b.1)));
    let mut groups: Vec<(f64, Vec<&str>)> = Vec::new();
    for (angle, word) in sorted {
        svg.line("l-mark", polar(angle, OUTER - 5.0), polar(angle, OUTER + 5.0));
        match groups.last_mut() {
            Some((first, words)) if angle - *first < APART_DEG => words.push(word),
            _ => groups.push((angle, vec![word])),
        }
    }
    for (angle, mut words) in groups {
        words.sort_unstable();
        words.dedup();
        // The labels go beside the labels of the quarters, not on them.
        let off = (angle + 45.0).rem_euclid(90.0) - 45.0;
        let beside = if off.abs() < NAME_DEG { NAME_DEG.copysign(off) - off } else { 1.0 };
        let [x, y] = polar(angle + beside, OUTER + 15.0);
        svg.text("halo", [x, y + 4.0], Anchor::Middle, &words.join(","));
    }
}

/// Position in pixels of an angle (counter-clockwise from the right) and a radius.
fn polar(angle_deg: f64, radius: f64) -> [f64; 2] {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    [CENTRE[0] + radius * cos, CENTRE[1] - radius * sin]
}
