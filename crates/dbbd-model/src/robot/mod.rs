//! The kinematic model: poses, the length between the balls, and its derivatives.
//!
//! Craig's modified DH with Hayati's beta: row i of a robot is
//! `Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d)` with `theta = sign * A + theta_offset`. A is the axis angle of the
//! controller; for a coupled joint it is the sum of two axis angles. Lengths are in mm, angles in rad; files have
//! degrees.

mod catalogue;
pub use catalogue::RobotFinding;

mod chain;
mod controller;
mod controller_frames;
mod coupling;
mod definition;
mod dh_row;
mod drift;
mod file;
mod ids;
pub mod inverse;
mod joint_axes;
mod joint_error;
mod joint_table;
pub mod kinematics;
mod load;
mod maker;
mod months;
pub mod parameter;
pub mod pose;
mod posterior;
mod tolerance;
mod uncertainty;

pub(crate) use chain::{AxesAtPose, FurtherColumns, KinematicChain, TrackerPlane};
pub use chain::{JointSinCos, LengthRow};
pub use controller::ControllerModel;
pub use controller_frames::ControllerFrames;
pub use coupling::{CoupledAxis, Coupling};
pub use definition::{LoadedRobot, Robot};
pub use dh_row::DhRow;
pub use drift::{Drift, MeasurementConditions, ZeroSteps};
pub use ids::{
    Approach, AxisAngles, BallId, BarId, CircleId, Coordinate, Datum, Joint, PayloadId, TargetId,
    max_axis_difference,
};
pub use joint_axes::{ArmTable, JointAxis};
pub use joint_error::{
    JointErrorModel, JointErrors, JointTerm, Ripple, SmoothJointError, TermKind, VisitedAngles,
};
pub use joint_table::{CouplingTable, JointTable};
pub use kinematics::Geometry;
pub use load::{ArmLoad, Mass, Payload};
pub use maker::Maker;
pub(crate) use months::season_k;
pub use parameter::{ParamGroup, ParamId, ParamOwner, ParamUnit, PriorRule};
pub use pose::Pose;
pub use posterior::RobotPosterior;
pub use tolerance::Tolerance;
pub use uncertainty::{GaussianProcess, RobotUncertainty};

/// Number of axes of a robot.
pub const AXES: usize = 6;

#[cfg(test)]
mod tests;
