//! The robot of a description as its controller shows it.

use dbbd_model::robot::{AXES, CoupledAxis, Coupling, Joint, Maker, Pose, Robot};

use super::arm_lines::ImportedRobot;
use super::catalogue::DescriptionFinding;

/// What a user knows of the robot beside its description.
#[derive(Clone, Copy, Debug, Default)]
pub struct KnownOfRobot<'a> {
    /// The nominal robot of the type, which a factory calibration needs.
    pub like: Option<&'a Robot>,
    /// The six joints of a URDF that has several chains.
    pub joints: &'a [String],
    pub maker: Option<Maker>,
    pub coupled: Option<Coupled>,
    /// A pose as the controller shows it.
    pub shown: Option<&'a PendantPose>,
}

/// Whether axis 3 is shown against axis 2 or against the horizontal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coupled {
    No,
    Yes,
}

impl Coupled {
    pub const ALL: [Self; 2] = [Self::No, Self::Yes];

    pub fn name(self) -> &'static str {
        match self {
            Self::No => "no",
            Self::Yes => "yes",
        }
    }

    /// The same arm with this coupling of axis 3. The limits of joint 3, against axis 2, remain.
    pub(super) fn applied(self, mut robot: Robot) -> Robot {
        const PLACE: usize = 2;
        let joint_deg = robot.joint_range_deg(Joint::J3);
        robot.geometry.coupling = Coupling::default();
        robot.coupled_limits_deg[PLACE] = None;
        robot.limits_deg[PLACE] = joint_deg;
        if self == Self::No {
            return robot;
        }
        // Axes of equal sense turn the third link by A3 - A2 against the second one.
        let [second, third] = [1, PLACE].map(|row| robot.geometry.rows[row]);
        let axes = robot.geometry.joint_axes();
        let sense = axes[1].direction.dot(&axes[PLACE].direction) * second.sign * third.sign;
        let factor = if sense > 0.0 { -1.0 } else { 1.0 };
        let by = CoupledAxis { axis: Joint::J2, factor };
        let mut joints = [None; AXES];
        joints[PLACE] = Some(by);
        robot.geometry.coupling = Coupling::new(joints);
        robot.coupled_limits_deg[PLACE] = Some(joint_deg);
        let added = robot.limits_deg[1].map(|deg| factor * deg);
        let [low, high] = [added[0].min(added[1]), added[0].max(added[1])];
        robot.limits_deg[PLACE] = [joint_deg[0] - high, joint_deg[1] - low];
        robot
    }
}

/// A pose of the flange as the controller shows it, with a null tool and a null base.
#[derive(Clone, Debug, PartialEq)]
pub struct PendantPose {
    pub axes_deg: [f64; AXES],
    /// In the World of the controller.
    pub xyz_mm: [f64; 3],
    /// KUKA's A, B, C.
    pub abc_deg: Option<[f64; 3]>,
}

impl PendantPose {
    /// Pendants show hundredths of a millimetre and of a degree; arms differ by millimetres where a description is another robot.
    const SAME_MM: f64 = 0.5;
    const SAME_DEG: f64 = 0.1;

    /// How far the flange of a robot is from this pose, mm and degrees.
    fn off(&self, robot: &Robot) -> [f64; 2] {
        let flange = robot.geometry.rigid().flange(&self.axes_deg.map(f64::to_radians));
        let flange = robot.frames.base.then(&flange).then(&robot.frames.flange);
        let shown = Pose::from_kuka(self.xyz_mm, self.abc_deg.unwrap_or_else(|| flange.abc_deg()));
        [(flange.position - shown.position).norm(), flange.angle_to(&shown).to_degrees()]
    }

    /// The robot that is at this pose, with the coupling that it shows: what the description does not say is known then.
    pub(super) fn proved(&self, imported: ImportedRobot) -> Result<ImportedRobot, DescriptionFinding> {
        let coupled = Coupled::ALL.map(|coupled| coupled.applied(imported.robot.clone()));
        let tried = [imported.robot.clone()].into_iter().chain(coupled);
        let mut nearest = [f64::INFINITY; 2];
        for robot in tried {
            let [off_mm, off_deg] = self.off(&robot);
            if off_mm < Self::SAME_MM && off_deg < Self::SAME_DEG {
                let is_frame = |finding: &DescriptionFinding| finding.is_about_frames();
                let findings = imported.findings.into_iter().filter(is_frame).collect();
                return Ok(ImportedRobot { robot, findings, ..imported });
            }
            if off_mm < nearest[0] {
                nearest = [off_mm, off_deg];
            }
        }
        let [off_mm, off_deg] = nearest;
        Err(DescriptionFinding::OtherPose { off_mm, off_deg })
    }
}

impl DescriptionFinding {
    fn is_about_frames(&self) -> bool {
        matches!(self, Self::BaseElsewhere { .. } | Self::FlangeElsewhere { .. })
    }
}
