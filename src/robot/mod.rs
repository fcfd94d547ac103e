//! The kinematic model: poses, the length between the balls, and its derivatives.
//!
//! Craig's modified DH with Hayati's beta: row i of a robot is
//! `Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d)` with `theta = sign * A + theta_offset`. A is the axis angle of the controller; of a
//! coupled joint it is the sum of two. Lengths are in mm, angles in rad; files have degrees.

pub mod chain;
pub mod coupling;
pub mod definition;
pub mod file;
pub mod ids;
pub mod inverse;
pub mod joint_error;
pub mod joint_table;
pub mod kinematics;
pub mod parameter;
pub mod pose;
pub mod posterior;
pub mod uncertainty;

pub use chain::{At, Chain, JointSinCos, LengthRow, Plane};
pub use coupling::{CoupledAxis, Coupling};
pub use definition::{Robot, RobotRead, Tolerance};
pub use ids::{Approach, AxisAngles, BallId, BarId, CircleId, Coordinate, Datum, Joint, TargetId, apart};
pub use joint_error::{JointError, JointErrors, JointTerm, Ripple, Smooth, TermKind, Visited};
pub use kinematics::{DhRow, Geometry, Mass};
pub use parameter::{Group, ParamId, Unit};
pub use pose::Pose;
pub use posterior::RobotPosterior;
pub use uncertainty::{Process, RobotUncertainty};

/// Number of axes of a robot.
pub const AXES: usize = 6;
