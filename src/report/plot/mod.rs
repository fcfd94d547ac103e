//! The plots: each a plain struct of data that draws itself as an SVG text.

pub mod against_axis;
pub mod frame;
pub mod heat_map;
pub mod histogram;
pub mod intervals;
pub mod polar;
pub mod residuals;
mod thinning;
pub mod trace;
pub mod view;

pub use heat_map::HeatMap;
pub use histogram::Histogram;
pub use intervals::{Interval, Intervals};
pub use polar::{PolarPlot, PolarTrace};
pub use residuals::{ResidualPlot, ResidualPoint};
pub use trace::{Line, TracePlot};
pub use view::{Projection, View};

/// How a series is drawn; the three differ in colour and in form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Series {
    /// Vermilion, hollow dots: before, or the first direction.
    First,
    /// Blue, filled dots: after, or the second direction.
    Second,
    /// Green, dashed: a third, such as a mean.
    Third,
}

impl Series {
    fn line(self) -> &'static str {
        match self {
            Self::First => "l-before",
            Self::Second => "l-after",
            Self::Third => "l-third",
        }
    }

    fn dot(self) -> &'static str {
        match self {
            Self::First => "d-before",
            Self::Second => "d-after",
            Self::Third => "d-third",
        }
    }
}

/// A series' dot with its name, left to right from `at`; returns where the next begins.
fn legend(svg: &mut super::svg::Svg, at: [f64; 2], series: Series, name: &str) -> f64 {
    let [x, y] = at;
    svg.circle(series.dot(), [x + 4.0, y - 4.0], 3.5, "");
    svg.text("soft", [x + 13.0, y], super::svg::Anchor::Start, name);
    x + 13.0 + 7.0 * name.chars().count() as f64 + 14.0
}
