//! Patches a user's own URDF: the origins of its six joints become the identified ones; every other byte is kept.
//!
//! Link i of the URDF is fixed to frame i of the robot's DH table by C_i, which the nominal robot gives: a rotation that takes
//! the joint's axis to the frame's z in the controller's sense, and a shift along it. The new origin of joint i is
//! `C_(i-1)^-1 M_i C_i`, where M_i is the identified row at axis angle 0. So link 6, and all that is fixed to it, moves
//! exactly as the identified flange. C_0 is the place of the URDF's root link in the robot base.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix3, Rotation3, Vector3};
use roxmltree::{Document, Node};
use serde::Serialize;

use super::urdf::origin_tag;
use crate::report::ReportFinding::{
    self, NoSixJoints, NoSuchJoint, NoUrdf, NotNumbers, NotXml, OtherCount, OtherJoint, OtherOrder, OtherUrdf,
};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::DhRow;
use dbbd_model::robot::pose::{rot_x, rot_y, rot_z};
use dbbd_model::robot::{AXES, Geometry, Pose, Robot};

/// A larger deviation from the nominal robot's joint means another robot or another zero position.
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
    /// Deviation of its axis from the nominal robot's, before the patch.
    pub from_nominal_mm: f64,
    pub from_nominal_deg: f64,
    pub moved_mm: f64,
    pub turned_deg: f64,
}

struct UrdfJoint<'a> {
    node: Node<'a, 'a>,
    name: &'a str,
    /// The fixed joints between the movable joint before and this one.
    fixed_before: Pose,
    origin: Pose,
    /// Unit vector in the joint's frame.
    axis: Vector3<f64>,
}

/// Puts the identified geometry of `robot` into a URDF; `names` are its six joints, in order, where the file has more.
pub fn patch(file: &str, text: &str, robot: &Robot, names: &[String]) -> Result<PatchedUrdf, Diagnostic> {
    let document = Document::parse(text).map_err(|error| {
        let at = error.pos();
        Diagnostic::position(file, text, at.row as usize, at.col as usize, NotXml { why: error.to_string() })
    })?;
    let joints = Reader { file, text, document: &document }.six(names)?;
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
            match child(*joint, "origin") {
                Some(old) => (old.range(), tag),
                // Before the first child; a joint always has children, its links.
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
fn row_pose(row: &DhRow) -> Pose {
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

/// The URDF's joints and those of the nominal robot.
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

    /// Deviation of a joint's axis from the nominal robot's, with the root link at `root`.
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

struct Reader<'a> {
    file: &'a str,
    text: &'a str,
    document: &'a Document<'a>,
}

impl<'a> Reader<'a> {
    fn refused(&self, node: Node<'_, '_>, finding: ReportFinding) -> Diagnostic {
        let at = self.document.text_pos_at(node.range().start);
        Diagnostic::position(self.file, self.text, at.row as usize, at.col as usize, finding)
    }

    fn joints(&self) -> impl Iterator<Item = Node<'a, 'a>> {
        self.document.root_element().children().filter(|node| node.has_tag_name("joint"))
    }

    /// The joints from the root to this one.
    fn path(&self, joint: Node<'a, 'a>) -> Vec<Node<'a, 'a>> {
        let mut path = vec![joint];
        // A joint that is on the path already ends it: the links form a loop.
        while let Some(parent) = link(path[path.len() - 1], "parent")
            && let Some(before) = self.joints().find(|joint| link(*joint, "child") == Some(parent))
            && !path.contains(&before)
        {
            path.push(before);
        }
        path.reverse();
        path
    }

    /// The six joints of the arm: those with these names, or the first six of every chain.
    fn six(&self, names: &[String]) -> Result<Vec<UrdfJoint<'a>>, Diagnostic> {
        let root = self.document.root_element();
        if !root.has_tag_name("robot") {
            return Err(self.refused(root, NoUrdf { root: root.tag_name().name().into() }));
        }
        if !names.is_empty() && names.len() != AXES {
            return Err(self.refused(root, OtherCount { named: names.len() }));
        }
        let is_arm = |path: &Vec<Node<'_, '_>>| {
            let found = path.iter().copied().filter(|joint| movable(*joint)).map(name);
            if names.is_empty() { found.count() == AXES } else { found.eq(names.iter().map(String::as_str)) }
        };
        let joints = self.joints().filter(|joint| movable(*joint));
        let mut chains: Vec<Vec<_>> = joints.map(|joint| self.path(joint)).filter(is_arm).collect();
        let finding = self.no_chain(names, chains.len());
        let chain = chains.pop().filter(|_| chains.is_empty()).ok_or_else(|| self.refused(root, finding))?;
        let mut six = Vec::new();
        let mut fixed_before = Pose::identity();
        for node in chain {
            let origin = self.origin(node)?;
            if !movable(node) {
                fixed_before = fixed_before.then(&origin);
                continue;
            }
            if !matches!(kind(node), "revolute" | "continuous") {
                return Err(
                    self.refused(node, OtherJoint { joint: name(node).into(), kind: kind(node).into() })
                );
            }
            let axis = match child(node, "axis") {
                Some(axis) => self.numbers(axis, "xyz")?,
                None => Vector3::x(),
            };
            let axis = axis.try_normalize(1e-9).ok_or_else(|| self.refused(node, not_numbers("axis")))?;
            six.push(UrdfJoint { node, name: name(node), fixed_before, origin, axis });
            fixed_before = Pose::identity();
        }
        Ok(six)
    }

    /// Why there is not one chain.
    fn no_chain(&self, names: &[String], chains: usize) -> ReportFinding {
        let found: Vec<&str> = self.joints().filter(|joint| movable(*joint)).map(name).collect();
        let joints = found.join(", ");
        match names.iter().find(|name| !found.contains(&name.as_str())) {
            Some(joint) => NoSuchJoint { joint: joint.clone(), joints },
            None if names.is_empty() => NoSixJoints { chains, joints },
            None => OtherOrder { named: names.join(", ") },
        }
    }

    /// The origin of a joint, mm.
    fn origin(&self, joint: Node<'_, '_>) -> Result<Pose, Diagnostic> {
        let Some(origin) = child(joint, "origin") else { return Ok(Pose::identity()) };
        let rpy = self.numbers(origin, "rpy")?;
        Ok(Pose {
            rotation: rot_z(rpy.z) * rot_y(rpy.y) * rot_x(rpy.x),
            position: self.numbers(origin, "xyz")? * 1e3,
        })
    }

    /// The three numbers of an attribute; zeros if it is absent.
    fn numbers(&self, node: Node<'_, '_>, attribute: &str) -> Result<Vector3<f64>, Diagnostic> {
        let Some(text) = node.attribute(attribute) else { return Ok(Vector3::zeros()) };
        let numbers: Option<Vec<f64>> = text
            .split_ascii_whitespace()
            .map(|word| word.parse().ok().filter(|x: &f64| x.is_finite()))
            .collect();
        match numbers.as_deref() {
            Some([x, y, z]) => Ok(Vector3::new(*x, *y, *z)),
            _ => Err(self.refused(node, not_numbers(attribute))),
        }
    }
}

fn not_numbers(attribute: &str) -> ReportFinding {
    NotNumbers { attribute: attribute.into() }
}

fn child<'a>(node: Node<'a, 'a>, tag: &str) -> Option<Node<'a, 'a>> {
    node.children().find(|child| child.has_tag_name(tag))
}

fn link<'a>(joint: Node<'a, 'a>, end: &str) -> Option<&'a str> {
    child(joint, end)?.attribute("link")
}

fn name<'a>(joint: Node<'a, '_>) -> &'a str {
    joint.attribute("name").unwrap_or_default()
}

fn kind<'a>(joint: Node<'a, '_>) -> &'a str {
    joint.attribute("type").unwrap_or_default()
}

fn movable(joint: Node<'_, '_>) -> bool {
    kind(joint) != "fixed"
}

/// What a rigid model such as a URDF leaves out of a robot: the displacement of its tool ball by gear errors, compliance and
/// errors of joints without backlash, mm.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LeftOut {
    pub mean_mm: f64,
    pub max_mm: f64,
}

impl LeftOut {
    /// Over poses (axis angles, rad); `None` for a rigid robot.
    pub fn of(geometry: &Geometry, poses: &[[f64; AXES]]) -> Option<Self> {
        let rigid = geometry.rigid();
        let moved: Vec<f64> = poses
            .iter()
            .map(|axes| (geometry.ball(axes).position - rigid.ball(axes).position).norm())
            .collect();
        let max_mm = moved.iter().copied().fold(0.0, f64::max);
        (max_mm > 0.0).then(|| Self { mean_mm: moved.iter().sum::<f64>() / moved.len() as f64, max_mm })
    }
}
