//! What is known of robot, set-up and bar: a model and its covariance, and what lengths add to it.
//!
//! The covariance is kept as a root, C = root root'. In the coordinates w of x = x0 + root w what is
//! known is a unit normal, and lengths of deviation sigma add the rows J root / sigma to it: with
//! Q R = [I; J root / sigma] the new root is root R^-1. No matrix is squared, so mm and rad, and what is
//! known well beside what is not known at all, do not disturb each other.

use nalgebra::{DMatrix, DVector};

use crate::linalg::Triangle;
use crate::model::{AXES, LengthModel, LengthRow, ParamId, Reading, Robot, Selection, parameter};

/// How well the set-up is known before anything is measured, mm: tool ball, base balls, bar.
const TOOL_MM: f64 = 0.1;
const CENTRE_MM: f64 = 10.0;
const BAR_MM: f64 = 0.05;

/// The size of a joint's compliance on robots of this kind, rad/(N m): one degree-minute at 300 N m.
const COMPLIANCE: f64 = 1e-6;

/// Gauss-Newton steps of [`Belief::learn`]: the model is near the truth, so they settle at once.
const STEPS: usize = 6;

/// How well a parameter is known before anything is measured, one standard deviation in its unit: the robot's own by
/// its tolerance, the bar to `bar_mm`, else to 0.05 mm.
pub fn known_beforehand(robot: &Robot, id: ParamId, bar_mm: Option<f64>) -> f64 {
    match id {
        ParamId::Tool(_) => TOOL_MM,
        ParamId::Centre(..) => CENTRE_MM,
        ParamId::BarOffset(_) => bar_mm.unwrap_or(BAR_MM),
        ParamId::Compliance(_) => COMPLIANCE,
        id if id.unit() == "mm" => robot.tolerance.length_mm,
        _ => robot.tolerance.angle_deg.to_radians(),
    }
}

/// A model with the covariance of its parameters.
#[derive(Clone, Debug)]
pub struct Belief {
    /// The likeliest model.
    pub model: LengthModel,
    ids: Vec<ParamId>,
    selection: Selection,
    root: DMatrix<f64>,
}

impl Belief {
    /// With independent parameters of standard deviations `sd` (mm, rad), about `model`.
    pub fn new(model: LengthModel, ids: &[ParamId], sd: &[f64]) -> Self {
        let root = DMatrix::from_diagonal(&DVector::from_column_slice(sd));
        Self { model, ids: ids.to_vec(), selection: Selection::new(ids), root }
    }

    /// What is known before anything is measured: the robot by its tolerance, the tool ball to 0.1 mm, the base
    /// balls to 10 mm, the bar to `bar_mm` (its certificate's standard deviation), else to 0.05 mm.
    pub fn datasheet(robot: &Robot, model: LengthModel, bar_mm: Option<f64>) -> Self {
        let ids = parameter::all(&robot.parallel_joints(), model.centres.len());
        let sd: Vec<f64> = ids.iter().map(|id| known_beforehand(robot, *id, bar_mm)).collect();
        Self::new(model, &ids, &sd)
    }

    /// The parameters, in the order of the rows of [`Belief::root`].
    pub fn ids(&self) -> &[ParamId] {
        &self.ids
    }

    /// The root of the covariance: C = root root', mm and rad.
    pub fn root(&self) -> &DMatrix<f64> {
        &self.root
    }

    /// Standard deviation of parameter `at`, mm or rad.
    pub fn sd(&self, at: usize) -> f64 {
        self.root.row(at).norm()
    }

    /// The derivative of the length from base ball `centre` (from 0) at `axes` (rad) in the coordinates of the
    /// root, mm: its norm is the length's standard deviation.
    pub fn swing(&self, axes: &[f64; AXES], centre: usize) -> DVector<f64> {
        let Some(ball) = self.model.centres.get(centre) else {
            return DVector::zeros(self.root.ncols());
        };
        self.swing_of(&self.model.geometry.length_row(axes, ball, 0.0), centre)
    }

    fn swing_of(&self, row: &LengthRow, centre: usize) -> DVector<f64> {
        let mut picked = DVector::zeros(self.ids.len());
        self.selection.pick(row, centre, picked.as_mut_slice());
        self.root.tr_mul(&picked)
    }

    /// As this one, with base ball `centre` (from 0) touched by the tool ball at `axes` (rad) to `sd_mm`: the ball is
    /// then wrong as the robot is wrong there. No length to this ball may have been measured yet.
    pub fn touched(&self, centre: usize, axes: &[f64; AXES], sd_mm: f64) -> Self {
        let mut touched = self.clone();
        let ball = self.model.geometry.ball(axes).position;
        for axis in 0..3 {
            let Some(at) = self.ids.iter().position(|id| *id == ParamId::Centre(centre + 1, axis)) else {
                continue;
            };
            // The derivative of a length from a far point is that of the position along the line to it.
            let mut far = ball;
            far[axis] -= 1.0;
            let row = self.model.geometry.length_row(axes, &far, 0.0);
            let mut there = self.root.row(at) * 0.0;
            for (parameter, id) in self.ids.iter().enumerate() {
                if !matches!(id, ParamId::Centre(..) | ParamId::BarOffset(_)) {
                    there += self.root.row(parameter) * row.columns()[LengthRow::position(*id)];
                }
            }
            // Unmeasured, the ball has had this coordinate to itself.
            there[at] += sd_mm;
            touched.root.set_row(at, &there);
        }
        touched
    }

    /// What will be known after lengths at these poses, each with standard deviation `sigma_mm`.
    /// `None` when a number is not finite.
    pub fn after(&self, readings: &[Reading], sigma_mm: f64) -> Option<Self> {
        let (root, _) = self.solve(readings, sigma_mm, &DVector::zeros(self.root.ncols()))?;
        Some(Self { root, ..self.clone() })
    }

    /// What is known after these lengths: the likeliest model and its covariance. `None` when a
    /// number is not finite.
    pub fn learn(&self, readings: &[Reading], sigma_mm: f64) -> Option<Self> {
        let mut w = DVector::zeros(self.root.ncols());
        let mut now = self.clone();
        for _ in 0..STEPS {
            let at = Self { root: self.root.clone(), ..now };
            let (root, found) = at.solve(readings, sigma_mm, &w)?;
            w = found;
            let mut model = self.model.clone();
            for (id, step) in self.ids.iter().zip((&self.root * &w).iter()) {
                model.shift(*id, *step);
            }
            now = Self { model, root, ..at };
        }
        Some(now)
    }

    /// The new root and the coordinates w of the likeliest model, linearised at this model, which stands at `here`.
    fn solve(
        &self,
        readings: &[Reading],
        sigma_mm: f64,
        here: &DVector<f64>,
    ) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let unknowns = self.root.ncols();
        let mut triangle = Triangle::new(unknowns);
        for unknown in 0..unknowns {
            triangle.push_single(unknown, 1.0, 0.0);
        }
        let prepared = self.model.prepare();
        for reading in readings {
            let row = prepared.row(reading);
            let swing = self.swing_of(&row, reading.centre) / sigma_mm;
            let rest = (reading.length - row.length) / sigma_mm + swing.dot(here);
            triangle.push(swing.as_slice(), rest);
        }
        let inverse = triangle.factor().solve_upper_triangular(&DMatrix::identity(unknowns, unknowns))?;
        let found = triangle.solve()?;
        let root = &self.root * inverse;
        root.iter().all(|x| x.is_finite()).then_some((root, found))
    }
}
