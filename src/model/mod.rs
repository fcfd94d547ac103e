//! Robot and bar as functions: poses, the length between the balls, and its derivatives.
//!
//! Craig's modified DH with Hayati's beta: row i of a robot is
//! `Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d)`, with `theta = sign * A + theta_offset` and A the
//! controller's axis angle. Lengths are mm, angles rad inside; files carry degrees.

pub mod centre;
pub mod chain;
pub mod further;
pub mod inverse;
pub mod kinematics;
pub mod length;
pub mod observation;
pub mod parameter;
pub mod pose;
pub mod readings;
pub mod robot;

pub use centre::Centre;
pub use chain::{Chain, LengthRow, Turns};
pub use further::Further;
pub use kinematics::{Geometry, Mass, Row};
pub use length::{LengthModel, Prepared, Reading, Selection};
pub use observation::{Observation, Observations};
pub use parameter::ParamId;
pub use pose::Pose;
pub use readings::Readings;
pub use robot::Robot;

/// Axes of the robots that are modelled.
pub const AXES: usize = 6;
