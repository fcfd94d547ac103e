//! Machines and circular tests whose true lengths are known.

use dbbd_model::circular::{
    CirclePoint, CircleSense, CircleTrace, CircularEvaluation, CircularSettings, circular,
};

/// A machine and a test: the cases of `tests/independent/circular.py`.
#[derive(Clone, Copy)]
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) radius: f64,
    pub(crate) points: u32,
    pub(crate) first: f64,
    pub(crate) span: f64,
    pub(crate) centre: [f64; 2],
    pub(crate) offset: f64,
    pub(crate) e: [f64; 2],
    pub(crate) phi: f64,
    pub(crate) backlash: [f64; 2],
    pub(crate) both: bool,
}

pub(crate) const CASES: [Case; 3] = [
    Case {
        name: "full",
        radius: 150.0,
        points: 72,
        first: 0.0,
        span: 360.0,
        centre: [0.31, -0.17],
        offset: 0.023,
        e: [40e-6, -25e-6],
        phi: 60e-6,
        backlash: [0.004, 0.007],
        both: true,
    },
    Case {
        name: "arc",
        radius: 300.0,
        points: 90,
        first: 20.0,
        span: 220.0,
        centre: [0.5, 0.2],
        offset: -0.011,
        e: [10e-6, 30e-6],
        phi: -45e-6,
        backlash: [0.0, 0.003],
        both: false,
    },
    Case {
        name: "dense",
        radius: 100.0,
        points: 2000,
        first: 3.0,
        span: 360.0,
        centre: [-1.0, 0.6],
        offset: 0.005,
        e: [0.0, 80e-6],
        phi: 120e-6,
        backlash: [0.01, 0.002],
        both: true,
    },
];

impl Case {
    /// The angles of the test, degrees.
    pub(crate) fn angles(&self) -> Vec<f64> {
        let gaps = if self.span == 360.0 { self.points } else { self.points - 1 };
        (0..self.points).map(|i| self.first + self.span * f64::from(i) / f64::from(gaps)).collect()
    }

    /// The exact length at an angle: scale errors, squareness, reversal steps, a form of order 7 and 11.
    fn length(&self, angle_deg: f64, sense: CircleSense) -> f64 {
        let theta = angle_deg.to_radians();
        let (sin, cos) = theta.sin_cos();
        let (x, y) = (self.radius * cos, self.radius * sin);
        let turn = if sense == CircleSense::CounterClockwise { 1.0 } else { -1.0 };
        let going = |velocity: f64| if velocity * turn >= 0.0 { 0.5 } else { -0.5 };
        let px = (1.0 + self.e[0]) * x + self.phi * y + self.backlash[0] * going(-sin);
        let py = (1.0 + self.e[1]) * y + self.backlash[1] * going(cos);
        let form = 0.002 * (7.0 * theta + 0.3).sin() + 0.0015 * (11.0 * theta).cos();
        (px - self.centre[0]).hypot(py - self.centre[1]) + self.offset + form
    }

    /// The traces of the test without noise.
    pub(crate) fn traces(&self) -> Vec<CircleTrace> {
        let mut senses = vec![CircleSense::CounterClockwise];
        senses.extend(self.both.then_some(CircleSense::Clockwise));
        senses
            .into_iter()
            .map(|sense| {
                let mut angles = self.angles();
                if sense == CircleSense::Clockwise {
                    angles.reverse();
                }
                trace("1", sense, angles.into_iter().map(|angle| (angle, self.length(angle, sense))))
            })
            .collect()
    }
}

/// A trace of angles (degrees) and lengths (mm).
pub(crate) fn trace(run: &str, sense: CircleSense, lengths: impl Iterator<Item = (f64, f64)>) -> CircleTrace {
    let point = |(angle_deg, length_mm)| CirclePoint {
        angle_deg,
        length_mm,
        sigma_mm: None,
        t_s: None,
        temp_c: None,
        axes_deg: None,
        drives: None,
    };
    CircleTrace { run: run.into(), sense, points: lengths.map(point).collect() }
}

/// The evaluation without intervals.
pub(crate) fn exactly(traces: &[CircleTrace], radius: f64) -> CircularEvaluation {
    circular(traces, &CircularSettings { draws: 0, ..CircularSettings::new(radius) }).unwrap()
}

/// mm, of `tests/independent/circular.py` with scipy 1.17.1 and numpy 2.4.6.
pub(crate) const GOLDEN: &[(&str, &str, f64)] = &[
    ("full", "G_lsc", 0.02008549746958),
    ("full", "G_mzc", 0.01846461689354),
    ("full", "D", 0.02415301721588),
    ("full", "F_max", 0.03377969879011),
    ("full", "F_min", 0.01331979733536),
    ("full", "x", 0.3099494874703),
    ("full", "y", -0.1699907306241),
    ("full", "Gb", 0.02045990145476),
    ("full", "H", 0.007008003701316),
    ("full", "c2 ccw", 0.00479156984759),
    ("full", "s2 ccw", 0.005770865218895),
    ("full", "c2 cw", 0.005069171867199),
    ("full", "s2 cw", 0.003229475097011),
    ("arc", "G_lsc", 0.009944982233947),
    ("arc", "G_mzc", 0.008815214002595),
    ("arc", "D", -0.01067836620573),
    ("arc", "F_max", 0.5275928151609),
    ("arc", "F_min", -0.5501872419092),
    ("arc", "x", 0.5055049144962),
    ("arc", "y", 0.1920983127479),
    ("dense", "G_lsc", 0.02655259729698),
    ("dense", "G_mzc", 0.02541387500699),
    ("dense", "D", 0.009000376905778),
    ("dense", "F_max", 0.02096036625588),
    ("dense", "F_min", -0.005613291536889),
    ("dense", "x", -1.000035995631),
    ("dense", "y", 0.5999400004505),
    ("dense", "Gb", 0.02657365779277),
    ("dense", "H", 0.01000988023858),
    ("dense", "c2 ccw", -0.003996993148392),
    ("dense", "s2 ccw", 0.002604520289536),
    ("dense", "c2 cw", -0.004003446727896),
    ("dense", "s2 cw", 0.009394351718774),
];
