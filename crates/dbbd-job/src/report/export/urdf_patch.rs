//! Patches a user's own URDF: the origins of its six joints become the identified ones; every other byte is kept.
//!
//! Link i of the URDF is fixed to frame i of the robot's DH table by C_i, which the nominal robot gives: a rotation that takes
//! the joint's axis to the frame's z in the controller's sense, and a shift along it. The new origin of joint i is
//! `C_(i-1)^-1 M_i C_i`, where M_i is the identified row at axis angle 0. So link 6, and all that is fixed to it, moves
//! exactly as the identified flange. C_0 is the place of the URDF's root link in the robot base.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix3, Rotation3, Vector3};
use roxmltree::Node;
use serde::Serialize;

use super::urdf::origin_tag;
use crate::report::ReportFinding::OtherUrdf;
use crate::robot_description::urdf::{self, UrdfJoint, UrdfReader};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::DhRow;
use dbbd_model::robot::pose::{rot_x, rot_y, rot_z};
use dbbd_model::robot::{AXES, Geometry, Pose, Robot};

/// Largest deviation from the nominal robot's joint: a larger one means another robot or another zero position.
const OTHER_ROBOT_MM: f64 = 5.0;
const OTHER_ROBOT_DEG: f64 = 0.5;

/// The new URDF and its changes.
#[derive(Debug, Serialize)]
pub struct PatchedUrdf {
    #[serde(skip)]
    pub text: String,
    pub joints: Vec<PatchedJoint>,
}

#[derive(Debug, Serialize)]
pub struct PatchedJoint {
    pub name: String,
    /// Deviation of the joint's axis from the nominal robot's axis, before the patch.
    pub from_nominal_mm: f64,
    pub from_nominal_deg: f64,
    pub moved_mm: f64,
    pub turned_deg: f64,
}

/// Puts the identified geometry of `robot` into a URDF; `names` are its six joints, in order, if the file has more
/// joints.
pub fn patch(file: &str, text: &str, robot: &Robot, names: &[String]) -> Result<PatchedUrdf, Diagnostic> {
    let document = urdf::parse(file, text)?;
    let joints = UrdfReader::new(file, text, &document).six(names)?;
    let nominal = frames(&robot.controller().geometry);
    let signs = robot.geometry.rows.map(|row| row.sign);
    let links = Placement { nominal: &nominal, signs, joints: &joints };
    let root = links.root();
    let mut before = root;
    let (mut patched, mut changes) = (Vec::new(), Vec::new());
    for (at, joint) in joints.iter().enumerate() {
        let off = links.deviation(&root, at);
        if off.mm > OTHER_ROBOT_MM || off.deg > OTHER_ROBOT_DEG {
            let finding =
                OtherUrdf { joint: joint.name.into(), number: at + 1, off_mm: off.mm, off_deg: off.deg };
            let place = document.text_pos_at(joint.node.range().start);
            return Err(Diagnostic::line(file, place.row as usize, finding));
        }
        let fixed = links.fixed_to_frame(&root, at);
        let new = before.inverse().then(&row_pose(&robot.geometry.rows[at])).then(&fixed);
        let origin = joint.fixed_before.inverse().then(&new);
        patched.push(PatchedJoint {
            name: joint.name.into(),
            from_nominal_mm: off.mm,
            from_nominal_deg: off.deg,
            moved_mm: (origin.position - joint.origin.position).norm(),
            turned_deg: origin.angle_to(&joint.origin).to_degrees(),
        });
        changes.push((joint.node, origin));
        before = fixed;
    }
    Ok(PatchedUrdf { text: rewritten(text, &changes), joints: patched })
}

/// The text with new origins of these joints.
fn rewritten(text: &str, changes: &[(Node<'_, '_>, Pose)]) -> String {
    let mut edits: Vec<_> = changes
        .iter()
        .map(|(joint, origin)| {
            let tag = origin_tag(&origin.position, &origin.rotation);
            match urdf::child(*joint, "origin") {
                Some(old) => (old.range(), tag),
                // The new element goes before the first child; a joint always has children, its links.
                None => {
                    let at =
                        joint.first_element_child().map_or(joint.range().end, |first| first.range().start);
                    (at..at, tag)
                }
            }
        })
        .collect();
    edits.sort_by_key(|(range, _)| std::cmp::Reverse(range.start));
    let mut text = text.to_owned();
    for (range, tag) in edits {
        text.replace_range(range, &tag);
    }
    text
}

/// A row at axis angle 0.
pub(super) fn row_pose(row: &DhRow) -> Pose {
    let turned = rot_y(row.beta) * rot_x(row.alpha);
    let rotation = turned * rot_z(row.theta);
    Pose { rotation, position: turned.column(0) * row.a + rotation.column(2) * row.d }
}

/// The frames of the table at axis angles 0.
fn frames(geometry: &Geometry) -> [Pose; AXES] {
    let mut frame = Pose::identity();
    geometry.rows.map(|row| {
        frame = frame.then(&row_pose(&row));
        frame
    })
}

/// The URDF's joints and the joints of the nominal robot.
struct Placement<'a> {
    nominal: &'a [Pose; AXES],
    signs: [f64; AXES],
    joints: &'a [UrdfJoint<'a>],
}

struct AxisDeviation {
    mm: f64,
    deg: f64,
}

impl Placement<'_> {
    /// The frame of a joint at axis angles 0 in the root link.
    fn joint_frame(&self, at: usize) -> Pose {
        self.joints[..=at]
            .iter()
            .fold(Pose::identity(), |frame, joint| frame.then(&joint.fixed_before).then(&joint.origin))
    }

    /// Direction of an axis of the nominal robot, in the controller's sense.
    fn direction(&self, at: usize) -> Vector3<f64> {
        self.nominal[at].rotation.column(2) * self.signs[at]
    }

    /// Deviation of a joint's axis from the nominal robot's axis, with the root link at `root`.
    fn deviation(&self, root: &Pose, at: usize) -> AxisDeviation {
        let frame = root.then(&self.joint_frame(at));
        let z = self.direction(at);
        let axis = frame.rotation * self.joints[at].axis;
        let apart = frame.position - self.nominal[at].position;
        AxisDeviation {
            mm: (apart - z * z.dot(&apart)).norm(),
            deg: z.cross(&axis).norm().atan2(z.dot(&axis)).to_degrees(),
        }
    }

    /// The root link in the robot base: a multiple of a quarter turn without a shift if one fits, as in the files of most
    /// makers, else the best fit of the six axes.
    fn root(&self) -> Pose {
        let quarters = [0.0, 2.0, 1.0, 3.0]
            .map(|quarter| Pose { rotation: rot_z(quarter * FRAC_PI_2), position: Vector3::zeros() });
        let fits = |root: &Pose| {
            (0..AXES).all(|at| {
                let off = self.deviation(root, at);
                off.mm <= OTHER_ROBOT_MM && off.deg <= OTHER_ROBOT_DEG
            })
        };
        quarters.into_iter().find(fits).unwrap_or_else(|| self.fitted_root())
    }

    /// Kabsch's rotation of the directions, then the shift that brings the joints' origins nearest to the axes.
    fn fitted_root(&self) -> Pose {
        let frames: Vec<Pose> = (0..AXES).map(|at| self.joint_frame(at)).collect();
        let covariance = (0..AXES).fold(Matrix3::zeros(), |sum, at| {
            sum + frames[at].rotation * self.joints[at].axis * self.direction(at).transpose()
        });
        let rotation = Rotation3::from_matrix(&covariance.transpose()).into_inner();
        let (mut normal, mut rhs) = (Matrix3::zeros(), Vector3::zeros());
        for (at, frame) in frames.iter().enumerate() {
            let z = self.direction(at);
            let across = Matrix3::identity() - z * z.transpose();
            normal += across;
            rhs += across * (self.nominal[at].position - rotation * frame.position);
        }
        let position = normal.try_inverse().map_or_else(Vector3::zeros, |inverse| inverse * rhs);
        Pose { rotation, position }
    }

    /// C_i: the joint's frame in the frame of the table, with its axis turned to the frame's z.
    fn fixed_to_frame(&self, root: &Pose, at: usize) -> Pose {
        let apart = self.nominal[at].inverse().then(&root.then(&self.joint_frame(at)));
        let axis = apart.rotation * self.joints[at].axis;
        let z = Vector3::z() * self.signs[at];
        let turn =
            Rotation3::rotation_between(&axis, &z).map_or_else(Matrix3::identity, Rotation3::into_inner);
        Pose { rotation: turn * apart.rotation, position: Vector3::z() * apart.position.z }
    }
}
