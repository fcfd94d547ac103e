//! The plots: typed data drawn as SVG texts.

mod frame;
mod heat_map;
mod intervals;
mod joint_error;
mod minutes;
mod polar;
mod residuals;
mod trace;
mod trend;
mod view;

pub(super) use frame::{NARROW, PANEL, WIDE};
pub use heat_map::{HeatMap, Overlay};
pub(super) use intervals::{Interval, Intervals};
pub(super) use joint_error::joint_error;
pub(super) use minutes::error_after_minutes;
pub use polar::{PolarPlot, PolarTrace};
pub(super) use residuals::{ResidualPoint, ResidualSet, against_axis, histogram, residuals};
pub(super) use trace::Trace;
pub use trend::{Time, TrendLine, TrendPlot, TrendPoint};
pub(super) use view::{Projection, View};

use super::svg::{Anchor, Svg};

/// The style of a series; the three styles differ in colour and in form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Series {
    /// Vermilion, hollow dots: before, or the first direction.
    First,
    /// Blue, filled dots: after, or the second direction.
    Second,
    /// Green, dashed: a third, such as an unknown direction.
    Third,
}

impl Series {
    /// The classes of `plot.css` for lines, dots and bars.
    fn classes(self) -> [&'static str; 3] {
        match self {
            Self::First => ["l-before", "d-before", "f-before"],
            Self::Second => ["l-after", "d-after", "f-after"],
            Self::Third => ["l-third", "d-third", "f-after"],
        }
    }

    fn line(self) -> &'static str {
        self.classes()[0]
    }

    fn dot(self) -> &'static str {
        self.classes()[1]
    }

    fn bar(self) -> &'static str {
        self.classes()[2]
    }
}

/// The symbol before a name in a legend.
#[derive(Clone, Copy)]
enum Key {
    Dot(Series),
    Band,
    Outlier,
    Interval,
}

/// Names with their symbols, from left to right.
struct Legend {
    x: f64,
    baseline: f64,
}

impl Legend {
    fn new(baseline: f64) -> Self {
        Self { x: 4.0, baseline }
    }

    fn add(&mut self, svg: &mut Svg, key: Key, name: &str) {
        let (x, y) = (self.x, self.baseline - 4.0);
        let width = match key {
            Key::Dot(series) => {
                svg.circle(series.dot(), [x + 4.0, y], 3.5, "");
                13.0
            }
            Key::Band => {
                svg.rect("band", [x, y - 5.0], [x + 14.0, y + 5.0], "");
                19.0
            }
            Key::Outlier => {
                svg.cross("l-mark", [x + 4.0, y], 3.5);
                13.0
            }
            Key::Interval => {
                svg.line("l-bar", [x, y], [x + 20.0, y]);
                svg.circle("d-after", [x + 10.0, y], 3.4, "");
                26.0
            }
        };
        svg.text("soft", [x + width, self.baseline], Anchor::Start, name);
        self.x = x + width + 7.0 * name.chars().count() as f64 + 14.0;
    }
}
