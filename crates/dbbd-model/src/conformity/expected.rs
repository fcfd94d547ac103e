//! A calibrated robot in a new set-up: the posterior of its calibration, and the changes that mounting makes.

use nalgebra::{DMatrix, DVector};

use crate::estimation::posterior::Posterior;
use crate::estimation::priors::{FREE_BALL_MM, Priors};
use crate::robot::{AXES, BallId, BarId, Coordinate, ParamId, ParamUnit, Robot};

/// Possible changes by mounting since the calibration, as standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mounting {
    /// Standard deviation of each coordinate of the tool ball, mm.
    pub tool_mm: f64,
    pub balls: BallMounting,
    /// Standard deviation of the length of a bar, mm.
    pub bar_mm: f64,
}

/// The positions of the base balls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BallMounting {
    /// Remounted anywhere.
    Anywhere,
    /// Mounted at the given places, with this standard deviation of each coordinate, mm.
    About(f64),
    /// As in the calibration, with this standard deviation of each coordinate, mm: a ball that moved is a change.
    Kept(f64),
}

impl Mounting {
    /// Repeatability of mounting a ball in its seat, as a standard deviation, mm.
    pub const SEAT_REPEAT_MM: f64 = 0.01;

    /// Tool ball remounted in its seat, base balls anywhere, a bar with this standard uncertainty of its length, mm.
    pub fn again(robot: &Robot, bar_u_mm: Option<f64>) -> Self {
        let bar_mm = Priors::datasheet(robot, bar_u_mm).sd(ParamId::BarOffset(BarId::FIRST));
        Self { tool_mm: Self::SEAT_REPEAT_MM, balls: BallMounting::Anywhere, bar_mm }
    }
}

/// A robot in a new set-up before its check.
#[derive(Clone, Debug)]
pub struct Expected {
    pub posterior: Posterior,
    /// The columns of the root that belong to free coordinates of balls.
    pub(super) free: Vec<usize>,
    balls: BallMounting,
}

impl Expected {
    /// `known` is the posterior of the calibration (parameters, tool ball, and base balls that were kept). Its model has the
    /// balls and bars of the check.
    pub fn new(known: &Posterior, bars: usize, mounting: Mounting) -> Self {
        let mut ids = known.ids().to_vec();
        let mut added: Vec<(ParamId, f64)> =
            Coordinate::ALL.map(|axis| (ParamId::Tool(axis), mounting.tool_mm)).to_vec();
        added.extend((0..bars).map(|at| (ParamId::BarOffset(BarId::at(at)), mounting.bar_mm)));
        let bound = known.root().ncols() + added.len();
        let ball_mm = match mounting.balls {
            BallMounting::Anywhere => FREE_BALL_MM,
            BallMounting::About(mm) | BallMounting::Kept(mm) => mm,
        };
        for ball in 0..known.model.balls.len() {
            let ball = BallId::at(ball);
            added.extend(Coordinate::ALL.map(|axis| (ParamId::Ball(ball, axis), ball_mm)));
        }
        ids.extend(added.iter().map(|(id, _)| *id).filter(|id| !known.ids().contains(id)));
        // A parameter that the calibration did not estimate can change too.
        let unchanged: Vec<ParamId> = ParamId::denavit_hartenberg().filter(|id| !ids.contains(id)).collect();
        ids.extend(unchanged);
        // Rows: parameters of the calibration, of the set-up, coefficients of the joint errors.
        let (own, columns) = (known.ids().len(), known.root().ncols());
        let mut root = DMatrix::zeros(ids.len() + known.coefficients(), columns + added.len());
        root.view_mut((0, 0), (own, columns)).copy_from(&known.root().rows(0, own));
        let coefficients = known.root().rows(own, known.coefficients());
        root.view_mut((ids.len(), 0), coefficients.shape()).copy_from(&coefficients);
        for (column, (id, sd)) in added.iter().enumerate() {
            if let Some(row) = ids.iter().position(|other| other == id) {
                root[(row, columns + column)] = *sd;
            }
        }
        let free = if mounting.balls == BallMounting::Anywhere { bound..root.ncols() } else { 0..0 };
        let posterior = Posterior::with_root(known.model.clone(), &ids, root).with_errors_of_pose_of(known);
        Self { posterior, free: free.collect(), balls: mounting.balls }
    }

    /// Whether the base balls are where the calibration had them.
    pub fn are_balls_kept(&self) -> bool {
        matches!(self.balls, BallMounting::Kept(_))
    }

    /// Indices of the parameters of the posterior that are tested for changes: not remounted base balls, and not optional
    /// parameters, which no check determines.
    pub(super) fn changeable(&self) -> impl Iterator<Item = usize> {
        let kept = self.are_balls_kept();
        let is_changeable =
            move |id: &ParamId| !id.is_optional() && (kept || !matches!(id, ParamId::Ball(..)));
        let ids = self.posterior.ids().iter().enumerate();
        ids.filter(move |(_, id)| is_changeable(id)).map(|(at, _)| at)
    }

    /// The effects of typical changes on the length from a base ball at `axes` (rad), mm: an element for each tested parameter.
    pub fn effects(&self, axes: &[f64; AXES], ball: BallId) -> DVector<f64> {
        let derivative = self.posterior.derivative(axes, ball);
        let effect = |at: usize| derivative[at] * typical(self.posterior.ids()[at]);
        DVector::from_iterator(self.changeable().count(), self.changeable().map(effect))
    }

    /// The expected robot with possible changes of these parameters.
    pub fn changed(&self, parameters: &[ParamId]) -> Self {
        let ids = self.posterior.ids();
        let mut columns = DMatrix::zeros(self.posterior.root().nrows(), parameters.len());
        for (column, id) in parameters.iter().enumerate() {
            if let Some(row) = ids.iter().position(|other| other == id) {
                columns[(row, column)] = typical(*id);
            }
        }
        Self { posterior: self.posterior.clone().widened(&columns), ..self.clone() }
    }
}

/// Prior standard deviations of a change, as by a slipped coupling or a bent link.
const CHANGED_ANGLE: f64 = 0.05 * std::f64::consts::PI / 180.0;
const CHANGED_LENGTH_MM: f64 = 0.5;

/// The prior standard deviation of a change, mm or rad.
pub(super) fn typical(id: ParamId) -> f64 {
    match id.unit() {
        ParamUnit::Mm => CHANGED_LENGTH_MM,
        // A compliance is not tested for a change.
        ParamUnit::Rad | ParamUnit::RadPerNm => CHANGED_ANGLE,
    }
}
