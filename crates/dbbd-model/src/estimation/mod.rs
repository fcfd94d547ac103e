//! Identification: from lengths and positions to parameters.
//!
//! The most probable unknowns are estimated from the lengths L = |p - c| + b, and from the coordinates of a tracker as
//! distances from its planes. The unknowns are geometry, set-up, and errors that the geometry does not explain. Each
//! has a prior, whose variance is the one with the greatest evidence. A list of parameters can be estimated without a
//! prior. Every number has its standard deviation or the reason why it has none.
//!
//! [`linear_system()`] alone forms design rows, [`priors`] alone has prior standard deviations and limits, [`posterior`] alone
//! holds a covariance, and [`Calibration::complete`] alone makes a result.

mod catalogue;
pub use catalogue::{EstimationFinding, ResultFinding};

mod ball_motion;
mod calibration;
mod contradiction;
mod design_prediction;
mod difference;
mod distance;
mod effort;
mod estimator;
mod evidence;
mod findings;
mod fit;
mod hyper_parameters;
mod hypotheses;
mod identifiability;
mod input_checks;
mod joint_curve;
mod leave_one_out;
mod lengths;
pub mod linear_system;
mod monte_carlo;
mod noise_score;
mod noise_shape;
mod options;
mod parameters;
mod pose_rows;
mod position;
pub mod posterior;
mod prediction;
mod prior_rows;
pub mod priors;
mod program_uncertainty;
pub mod result;
mod ripple;
mod robot_draw;
mod selection;
mod shifted_rows;
mod solver;
mod start;
mod system;
mod unknowns;
mod validation;
mod validity;
pub mod wording;
mod workspace;

pub use ball_motion::tool_balls;
pub use calibration::{AngleSource, Calibration, Forecast, Input};
pub use design_prediction::{DesignPrediction, ParameterPrediction, PlannedLengths};
pub use difference::{CommonKnowledge, ExpectedDifference, PredictedDifference};
pub use distance::DistanceQuantities;
pub use estimator::{GroupEvidence, JointSummary};
pub use findings::{beyond_repeatability, fits_no_robot};
pub use hyper_parameters::Group;
pub use hypotheses::{EventPlace, EventTreatment, RunHypothesis, SupposedEventKind};
pub use identifiability::{
    Analysis, Combination, Correlation, Observability, analyse, correlations, observability, order_of_choice,
};
pub use input_checks::{check_measurements, measurement_findings};
pub use joint_curve::{JointPoint, joint_curve};
pub use linear_system::{factor, linear_system};
pub use options::{ErrorModel, Options};
pub use pose_rows::LengthNoise;
pub use position::{Orientations, Positions, ToolPoses, displacement};
pub use posterior::{Posterior, inverse_root, root_after};
pub use prediction::of_maker;
pub use priors::{Prior, Priors, largest_plausible, length_sd_mm};
pub use program_uncertainty::{PointUncertainty, ProgramUncertainty};
pub use result::{CalibrationResult, CompletedCalibration, DriftBasis, PositionParts, Validity};
pub use robot_draw::{with_drawn_joint_errors, with_mean_joint_errors, with_usual_joint_errors};
pub use selection::{is_place, without_open_places};
pub use validity::ValidityLimit;
pub use workspace::{ErrorSummary, SimplifiedModelError, Workspace};

#[cfg(test)]
mod tests;
