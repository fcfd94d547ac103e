//! What is expected of a robot in a new set-up: the posterior of its calibration, and what mounting changes.

use nalgebra::{DMatrix, DVector};

use super::pose_rows::LengthNoise;
use super::posterior::Posterior;
use super::priors::Priors;
use crate::measurement::PreparedMeasurement;
use crate::robot::{AXES, BallId, BarId, Coordinate, ParamId, Robot, Unit};

/// What mounting may have changed since the calibration: standard deviations, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mounting {
    /// Of each coordinate of the tool ball.
    pub tool_mm: f64,
    pub balls: BallMounting,
    /// Of the length of a bar.
    pub bar_mm: f64,
}

/// Where the base balls may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BallMounting {
    /// Mounted anew, anywhere.
    Anywhere,
    /// About the places given, with this standard deviation of each coordinate, mm.
    About(f64),
    /// Where the calibration had them, with this standard deviation of each coordinate, mm: one that moved is a change.
    Kept(f64),
}

impl Mounting {
    /// Standard deviation with which a ball is mounted again in its seat, mm.
    pub const SEAT_REPEAT_MM: f64 = 0.01;

    /// The tool ball in its seat again, base balls anywhere, a bar with this standard uncertainty of its length, mm.
    pub fn again(robot: &Robot, bar_u_mm: Option<f64>) -> Self {
        let bar_mm = Priors::datasheet(robot, bar_u_mm).sd(ParamId::BarOffset(BarId::FIRST));
        Self { tool_mm: Self::SEAT_REPEAT_MM, balls: BallMounting::Anywhere, bar_mm }
    }
}

/// A robot in a new set-up, before its check: what its calibration left unknown, and what mounting changes.
#[derive(Clone, Debug)]
pub struct Expected {
    posterior: Posterior,
    /// The columns of the root that nothing binds.
    free: Vec<usize>,
    balls: BallMounting,
}

/// Free coordinates of a base ball are taken from so far, mm.
pub(crate) const FREE_BALL_MM: f64 = 1000.0;

impl Expected {
    /// Of the calibrated robot `known` (its parameters and tool ball, and base balls that stayed) about its model, whose
    /// balls and bars are those of the check.
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
        // Parameters of the calibration, those of the set-up, coefficients of the joints' errors.
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
        let posterior = Posterior::with_root(known.model.clone(), &ids, root);
        Self { posterior, free: free.collect(), balls: mounting.balls }
    }

    /// The parameters whose change is looked for, by their places among those of the posterior: not base balls that are
    /// mounted anew, nor what no check determines.
    pub(super) fn changeable(&self) -> impl Iterator<Item = usize> {
        let kept = matches!(self.balls, BallMounting::Kept(_));
        let is_changeable =
            move |id: &ParamId| !id.is_optional() && (kept || !matches!(id, ParamId::Ball(..)));
        let ids = self.posterior.ids().iter().enumerate();
        ids.filter(move |(_, id)| is_changeable(id)).map(|(at, _)| at)
    }

    /// What a change of the usual size does to the length from a base ball at `axes` (rad): an element each parameter
    /// whose change is looked for, mm.
    pub fn effects(&self, axes: &[f64; AXES], ball: BallId) -> DVector<f64> {
        let derivative = self.posterior.derivative(axes, ball);
        let effect = |at: usize| derivative[at] * typical(self.posterior.ids()[at]);
        DVector::from_iterator(self.changeable().count(), self.changeable().map(effect))
    }

    /// The same where these parameters may have changed.
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

    pub(super) fn free(&self) -> &[usize] {
        &self.free
    }

    /// After the lengths: the likeliest model and its covariance. `None` when a number is not finite.
    pub fn learn(&self, readings: &[PreparedMeasurement], noise: LengthNoise<'_>) -> Option<Posterior> {
        self.posterior.learn(readings, noise)
    }

    /// After lengths at these poses that agree with the model. `None` when a number is not finite.
    pub fn after(&self, readings: &[PreparedMeasurement], noise: LengthNoise<'_>) -> Option<Posterior> {
        self.posterior.after(readings, noise)
    }

    pub fn posterior(&self) -> &Posterior {
        &self.posterior
    }
}

/// One standard deviation of a change, before it is measured: a slipped coupling, a bent link.
const CHANGED_ANGLE: f64 = 0.05 * std::f64::consts::PI / 180.0;
const CHANGED_LENGTH_MM: f64 = 0.5;

/// One standard deviation of a change, mm or rad.
pub(super) fn typical(id: ParamId) -> f64 {
    if id.unit() == Unit::Mm { CHANGED_LENGTH_MM } else { CHANGED_ANGLE }
}
