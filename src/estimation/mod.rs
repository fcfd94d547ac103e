//! From lengths to parameters.
//!
//! The lengths L = |p - c| + b, and the coordinates of a tracker as distances from its planes, are fitted by least squares over a base set of the parameters asked for, chosen at the
//! nominal geometry with the fitted set-up. What is poorly observable is fixed (or carried by the prior), and every number
//! comes with its standard deviation or the reason why it has none.
//!
//! [`linear_system`] alone forms rows, [`priors`] alone knows prior deviations and limits, [`posterior`] alone holds a
//! covariance, and [`Calibration::result`] alone makes a result.

mod calibration;
pub mod change;
mod contradiction;
mod distance;
mod estimate;
mod evidence;
pub mod expected;
mod findings;
mod fit;
pub mod fleet;
mod held;
mod inputs;
mod joint_curve;
mod joint_errors;
mod joint_fit;
mod joint_prediction;
mod joint_system;
mod left_out;
mod lengths;
pub mod linear_system;
mod monte_carlo;
mod noise_shape;
mod observability;
mod options;
mod outliers;
mod outlook;
mod pose_rows;
mod position;
pub mod posterior;
mod predicted;
mod prior;
pub mod priors;
mod rank;
mod remounted;
mod residual_tests;
mod residuals;
pub mod result;
pub mod result_file;
mod ripple;
mod selection;
mod setting;
mod shifted_rows;
mod sigma;
mod solver;
mod uncertainty;
mod units;
mod validation;
pub mod wording;
mod zero_change;

pub use calibration::{AngleSource, Calibration, Input};
pub use distance::DistanceQuantities;
pub use findings::beyond_repeatability;
pub use inputs::{check_measurements, doubts};
pub use joint_curve::{JointPoint, joint_curve};
pub use joint_fit::{GroupEvidence, JointSummary};
pub use left_out::left_out_mm;
pub use linear_system::{LinearSystem, factor};
pub use observability::{Correlation, Observability, correlations, observability};
pub use options::{ErrorModel, Options};
pub use outlook::{Foreseen, Outlook, outlook};
pub use pose_rows::LengthNoise;
pub use position::Positions;
pub use posterior::{Posterior, inverse_root, root_after};
pub use predicted::{ErrorSummary, Estimator, PositionParts, Workspace};
pub use priors::{Group, Prior, Priors, largest_plausible};
pub use rank::{Analysis, Combination, analyse, order_of_choice};
pub use remounted::{ChangedSetUp, Remounted, remounted};
pub use residual_tests::senses;
pub use result::CalibrationResult;
pub use result_file::{Beside, ResultFile};
pub(crate) use selection::{is_place, without_open_places};
pub use sigma::length_sd_mm;
pub use zero_change::ZeroChange;
