//! Radial deviation against the angle on the circle, magnified: the ball-bar's own picture.

use super::Series;
use super::frame::NARROW;
use super::legend;
use crate::report::scale::{Unit, decimals, magnitude, plain, rounded, signed, significant, step};
use crate::report::svg::{Anchor, Svg};

const HEIGHT: f64 = 500.0;
const CENTRE: [f64; 2] = [240.0, 258.0];
/// Radius of the outermost ring and of the ring of no deviation, pixels.
const OUTER: f64 = 192.0;
const ZERO: f64 = 108.0;
/// Neighbours further apart than this are not joined, degrees.
const GAP_DEG: f64 = 40.0;
/// Above this number of points the dots would hide the line.
const MOST_DOTS: usize = 400;

/// A polar plot of radial deviations.
#[derive(Clone, Debug, PartialEq)]
pub struct PolarPlot {
    /// What it shows.
    pub title: String,
    /// Nominal radius, mm; with it the magnification is stated.
    pub radius_mm: Option<f64>,
    /// What stands at 0 and 90 degrees, such as `+X` and `+Y`; the degrees where absent.
    pub axis_names: Option<[String; 2]>,
    /// The traces, drawn in order.
    pub traces: Vec<PolarTrace>,
}

/// One trace: a direction, or the state before or after.
#[derive(Clone, Debug, PartialEq)]
pub struct PolarTrace {
    /// Its name in the legend.
    pub name: String,
    /// How it is drawn.
    pub series: Series,
    /// Angle on the circle (degrees) and deviation (mm, outward positive), in any order.
    pub points: Vec<[f64; 2]>,
}

impl PolarPlot {
    /// Draws it.
    pub fn to_svg(&self) -> String {
        self.to_svg_with(&[])
    }

    /// Draws it with marks on the outermost ring: an angle (degrees) and a short word each. Marks that
    /// would stand on each other share one word.
    pub fn to_svg_with(&self, marks: &[(f64, String)]) -> String {
        let deviations = self.traces.iter().flat_map(|trace| trace.points.iter().map(|point| point[1]));
        let largest_mm = magnitude(deviations);
        let unit = Unit::length(largest_mm);
        let ring = step(largest_mm * unit.factor, 2.5);
        let rings = (largest_mm * unit.factor / ring - 1e-9).ceil().clamp(1.0, 4.0);
        let px_per_unit = (OUTER - ZERO) / (rings * ring);
        let note = self.note(ring, unit, px_per_unit * unit.factor);
        let mut svg = Svg::new(NARROW, HEIGHT, &self.title, &note);
        svg.text("head", [4.0, 16.0], Anchor::Start, &self.title);
        let mut x = 4.0;
        for trace in &self.traces {
            x = legend(&mut svg, [x, 36.0], trace.series, &trace.name);
        }
        self.spokes(&mut svg);
        let digits = decimals(ring);
        for number in -(rings as i32)..=(rings as i32) {
            let radius = ZERO + f64::from(number) * ring * px_per_unit;
            svg.circle(if number == 0 { "zero" } else { "grid" }, CENTRE, radius, "");
        }
        for trace in &self.traces {
            draw(&mut svg, trace, unit, px_per_unit, digits + 1);
        }
        mark(&mut svg, marks);
        for number in -(rings as i32)..=(rings as i32) {
            let value = f64::from(number) * ring;
            let at = polar(67.5, ZERO + value * px_per_unit);
            let sign = if number == rings as i32 { unit.sign } else { "" };
            let label = format!("{} {sign}", signed(value, digits));
            svg.text("halo", [at[0], at[1] + 4.0], Anchor::Middle, label.trim_end());
        }
        svg.text("soft", [0.5 * NARROW, HEIGHT - 6.0], Anchor::Middle, &note);
        svg.finish()
    }

    /// The scale in words.
    fn note(&self, ring: f64, unit: Unit, px_per_mm: f64) -> String {
        let spacing = format!("ring spacing {} {}", significant(ring, 1), unit.sign);
        match self.radius_mm {
            Some(radius) if radius.is_finite() && radius > 0.0 => {
                let magnification = px_per_mm * radius / ZERO;
                format!(
                    "{spacing}; radius {} mm, deviation magnified {} ×",
                    plain(radius, 3),
                    rounded(magnification, 2)
                )
            }
            _ => spacing,
        }
    }

    /// Lines each 30 degrees, names each 90.
    fn spokes(&self, svg: &mut Svg) {
        for number in 0..12 {
            svg.line("grid", CENTRE, polar(f64::from(number) * 30.0, OUTER));
        }
        let names = match &self.axis_names {
            Some([x, y]) => [x.clone(), y.clone(), opposite(x), opposite(y)],
            None => ["0°".into(), "90°".into(), "180°".into(), "270°".into()],
        };
        let anchors = [Anchor::Start, Anchor::Middle, Anchor::End, Anchor::Middle];
        for (quarter, (name, anchor)) in names.iter().zip(anchors).enumerate() {
            let [x, y] = polar(quarter as f64 * 90.0, OUTER + 6.0);
            let drop = [4.0, -2.0, 4.0, 10.0];
            svg.text("soft", [x, y + drop[quarter]], anchor, name);
        }
    }
}

/// Lines between neighbours and a dot each.
fn draw(svg: &mut Svg, trace: &PolarTrace, unit: Unit, px_per_unit: f64, digits: usize) {
    let mut points: Vec<[f64; 2]> = trace
        .points
        .iter()
        .filter(|point| point.iter().all(|value| value.is_finite()))
        .map(|&[angle, deviation]| [angle.rem_euclid(360.0), deviation])
        .collect();
    points.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let place =
        |[angle, deviation]: [f64; 2]| polar(angle, (ZERO + deviation * unit.factor * px_per_unit).max(0.0));
    // Under dots the line only leads the eye.
    let dots = points.len() <= MOST_DOTS;
    let class = format!("{}{}", trace.series.line(), if dots { " web" } else { "" });
    let near = |from: &[f64; 2], to: &[f64; 2]| to[0] - from[0] <= GAP_DEG;
    let mut arcs: Vec<Vec<[f64; 2]>> =
        points.chunk_by(near).map(|arc| arc.iter().map(|&point| place(point)).collect()).collect();
    let round = points.first().zip(points.last()).is_some_and(|(a, b)| a[0] + 360.0 - b[0] <= GAP_DEG);
    let closed = round && arcs.len() == 1;
    if round
        && !closed
        && let (Some(&first), Some(last)) = (points.first(), arcs.last_mut())
    {
        last.push(place(first));
    }
    for arc in &arcs {
        svg.path(&class, arc, closed);
    }
    if dots {
        for &point in &points {
            let value = signed(point[1] * unit.factor, digits);
            let tip = format!("{}: {}°, {value} {}", trace.name, signed(point[0], 1), unit.sign);
            svg.circle(trace.series.dot(), place(point), 2.4, &tip);
        }
    }
}

/// Ticks across the outermost ring, with their words outside.
fn mark(svg: &mut Svg, marks: &[(f64, String)]) {
    const APART_DEG: f64 = 6.0;
    /// Half of the room of an axis' name.
    const NAME_DEG: f64 = 8.0;
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
        // Beside the names of the axes, not on them.
        let off = (angle + 45.0).rem_euclid(90.0) - 45.0;
        let beside = if off.abs() < NAME_DEG { NAME_DEG.copysign(off) - off } else { 1.0 };
        let [x, y] = polar(angle + beside, OUTER + 15.0);
        svg.text("halo", [x, y + 4.0], Anchor::Middle, &words.join(","));
    }
}

/// Pixels of an angle (counter-clockwise from the right) and a radius.
fn polar(angle_deg: f64, radius: f64) -> [f64; 2] {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    [CENTRE[0] + radius * cos, CENTRE[1] - radius * sin]
}

/// `+X` against `−X`.
fn opposite(name: &str) -> String {
    match (name.strip_prefix('+'), name.strip_prefix(['-', '−'])) {
        (Some(axis), _) => format!("−{axis}"),
        (_, Some(axis)) => format!("+{axis}"),
        _ => format!("−{name}"),
    }
}
