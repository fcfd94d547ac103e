//! A URDF: its six moving joints, and the robot that they form.

use std::collections::{HashMap, HashSet};

use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::pose::{rot_x, rot_y, rot_z};
use dbbd_model::robot::{AXES, JointAxis, Maker, Pose, Robot};
use nalgebra::Vector3;
use roxmltree::{Document, Node};

use super::arm_lines::{ArmLines, ImportedRobot};
use super::catalogue::DescriptionFinding::{
    self, MoreJoints, NoSixJoints, NoSuchJoint, NoUrdf, NotNumbers, NotXml, OtherCount, OtherJoint,
    OtherOrder,
};
use super::controller::{Coupled, KnownOfRobot};

/// Links at which makers end an arm, the best first.
const ENDS: [&str; 2] = ["tool0", "flange"];
/// An axis is Z of a frame if it is off by less, mm and rad: descriptions have six digits.
const ON_AXIS: f64 = 1e-3;
/// Limits of a joint that turns without end: two turns to either side are common.
const ENDLESS_DEG: f64 = 360.0;
/// Speed of a joint that states none or zero, degrees/s.
pub(super) const USUAL_SPEED_DEG_S: f64 = 180.0;

/// The robot of a URDF as its controller knows it, with the limits and speeds of its joints.
pub(super) fn import(file: &str, text: &str, known: KnownOfRobot<'_>) -> Result<ImportedRobot, Diagnostic> {
    let document = parse(file, text)?;
    let reader = UrdfReader::new(file, text, &document);
    let joints = reader.six(known.joints)?;
    if known.joints.is_empty() {
        reader.check_ends(&joints)?;
    }
    let base = reader.base(&joints)?;
    // The base of the robot is that of its controller where axis 1 is its Z, else the first link.
    let first =
        joints.first().map(|joint| joint.fixed_before.then(&joint.origin)).unwrap_or(Pose::identity());
    let is_on_axis = |base: &Pose| {
        let first = base.inverse().then(&first);
        let axis = first.rotation * joints.first().map_or(Vector3::z(), |joint| joint.axis);
        axis.xy().norm() < ON_AXIS && first.position.xy().norm() < ON_AXIS
    };
    let root = base.filter(is_on_axis).unwrap_or(Pose::identity());
    let world = base.map_or(Pose::identity(), |base| base.inverse().then(&root));
    let mut frame = root.inverse();
    let mut axes = Vec::with_capacity(AXES);
    for joint in &joints {
        frame = frame.then(&joint.fixed_before).then(&joint.origin);
        axes.push(JointAxis { point: frame.position, direction: frame.rotation * joint.axis });
    }
    let flange = frame.then(&reader.end(&joints)?);
    let limits = joints.iter().map(|joint| reader.limits(joint)).collect::<Result<Vec<_>, _>>()?;
    let six = |_| reader.refused(document.root_element(), NoSixJoints { chains: 0, joints: String::new() });
    let limits: [JointLimits; AXES] =
        limits.try_into().map_err(|limits: Vec<JointLimits>| six(limits.len()))?;
    let mut axes: [JointAxis; AXES] = axes.try_into().map_err(|axes: Vec<JointAxis>| six(axes.len()))?;
    let mut signs = [1.0; AXES];
    // The last frame has its z out of the flange, whatever the sense of axis 6.
    if axes[AXES - 1].direction.dot(&flange.rotation.column(2)) < 0.0 {
        axes[AXES - 1].direction *= -1.0;
        signs[AXES - 1] = -1.0;
    }
    let lines = ArmLines { axes, signs, flange };
    let name = document.root_element().attribute("name").unwrap_or("arm");
    let maker = known.maker.or_else(|| reader.maker(name));
    let mut robot = Robot::rigid(name, limits.map(|limits| limits.deg), limits.map(|limits| limits.deg_s));
    robot.set_language(maker.and_then(Maker::language));
    let mut imported = lines.imported(robot, &world);
    let mimic = joints.iter().find(|joint| child(joint.node, "mimic").is_some());
    let is_coupled = |maker: &Maker| maker.couples([name].into_iter().chain(reader.shapes()));
    let coupled = known.coupled.or_else(|| maker.filter(is_coupled).map(|_| Coupled::Yes));
    if let Some(coupled) = coupled {
        imported.robot = coupled.applied(imported.robot);
    }
    let far = maker.filter(|maker| maker.counts_elsewhere() && base.is_none());
    let parallelogram = mimic.filter(|_| coupled.is_none());
    imported.findings.extend(maker.is_none().then_some(DescriptionFinding::MakerUnknown));
    imported.findings.extend(far.map(|maker| DescriptionFinding::NoBaseLink { maker: maker.name() }));
    imported.findings.extend(
        parallelogram.map(|joint| DescriptionFinding::Parallelogram { joint: joint.name.to_owned() }),
    );
    Ok(imported)
}

#[derive(Clone, Copy)]
struct JointLimits {
    deg: [f64; 2],
    deg_s: f64,
}

/// The document of a URDF.
pub(crate) fn parse<'a>(file: &str, text: &'a str) -> Result<Document<'a>, Diagnostic> {
    Document::parse(text).map_err(|error| {
        let at = error.pos();
        Diagnostic::position(file, text, at.row as usize, at.col as usize, NotXml { why: error.to_string() })
    })
}

/// A moving joint of an arm.
pub(crate) struct UrdfJoint<'a> {
    pub node: Node<'a, 'a>,
    pub name: &'a str,
    /// The fixed joints between the movable joint before and this one.
    pub fixed_before: Pose,
    pub origin: Pose,
    /// Unit vector of the axis in the joint's frame.
    pub axis: Vector3<f64>,
}

/// Reads the arm of a URDF.
pub(crate) struct UrdfReader<'a> {
    file: &'a str,
    text: &'a str,
    document: &'a Document<'a>,
    /// The first joint that leads to a link.
    before: HashMap<&'a str, Node<'a, 'a>>,
}

impl<'a> UrdfReader<'a> {
    pub(crate) fn new(file: &'a str, text: &'a str, document: &'a Document<'a>) -> Self {
        // Read backwards, so that the first joint stays.
        let before = all_joints(document).rev().filter_map(|joint| Some((link(joint, "child")?, joint)));
        Self { file, text, document, before: before.collect() }
    }

    fn refused(&self, node: Node<'_, '_>, finding: DescriptionFinding) -> Diagnostic {
        let at = self.document.text_pos_at(node.range().start);
        Diagnostic::position(self.file, self.text, at.row as usize, at.col as usize, finding)
    }

    /// The joints from the root to this one.
    fn path(&self, joint: Node<'a, 'a>) -> Vec<Node<'a, 'a>> {
        let before = |joint: &Node<'a, 'a>| self.before.get(link(*joint, "parent")?).copied();
        let mut seen = HashSet::new();
        // A joint that is on the path already ends it: the links form a loop.
        let path = std::iter::successors(Some(joint), before).take_while(|joint| seen.insert(*joint));
        let mut path: Vec<_> = path.collect();
        path.reverse();
        path
    }

    /// The six joints of the arm: those with these names, or the first six of every chain.
    pub(crate) fn six(&self, names: &[String]) -> Result<Vec<UrdfJoint<'a>>, Diagnostic> {
        let root = self.document.root_element();
        if self
            .document
            .descendants()
            .any(|node| node.tag_name().namespace().is_some_and(|space| space.contains("xacro")))
        {
            return Err(self.refused(root, DescriptionFinding::Xacro));
        }
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
        let joints = all_joints(self.document).filter(|joint| movable(*joint));
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

    /// The reason why there is not exactly one chain.
    fn no_chain(&self, names: &[String], chains: usize) -> DescriptionFinding {
        let found: Vec<&str> = all_joints(self.document).filter(|joint| movable(*joint)).map(name).collect();
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

fn all_joints<'a>(document: &'a Document<'a>) -> impl DoubleEndedIterator<Item = Node<'a, 'a>> {
    document.root_element().children().filter(|node| node.has_tag_name("joint"))
}

fn not_numbers(attribute: &str) -> DescriptionFinding {
    NotNumbers { attribute: attribute.into() }
}

pub(crate) fn child<'a>(node: Node<'a, 'a>, tag: &str) -> Option<Node<'a, 'a>> {
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

impl UrdfReader<'_> {
    /// The files of the shapes.
    fn shapes(&self) -> impl Iterator<Item = &str> {
        let shapes = self.document.descendants().filter(|node| node.has_tag_name("mesh"));
        shapes.filter_map(|mesh| mesh.attribute("filename"))
    }

    /// The maker that the robot's name, else the files of its shapes name.
    fn maker(&self, name: &str) -> Option<Maker> {
        let mut of_shapes = self.shapes().filter_map(Maker::named_in);
        let of_shapes = of_shapes.next().filter(|first| of_shapes.all(|other| other == *first));
        Maker::named_in(name).or(of_shapes)
    }

    /// The frame from which the controller counts, in the frame of the first link: that of the link `base` (REP 199), which is fixed to a
    /// link before the first joint.
    fn base(&self, joints: &[UrdfJoint<'_>]) -> Result<Option<Pose>, Diagnostic> {
        let Some(first) = joints.first() else { return Ok(None) };
        let is_base = |joint: &Node<'_, '_>| {
            let name = link(*joint, "child").unwrap_or_default();
            !movable(*joint) && (name == "base" || name.ends_with("_base") && !name.ends_with("base_link"))
        };
        let root = |joint: Node<'_, '_>| {
            self.path(joint).first().and_then(|first| link(*first, "parent").map(str::to_owned))
        };
        let is_before = |joint: &Node<'_, '_>| {
            self.path(*joint).into_iter().all(|before| !movable(before)) && root(*joint) == root(first.node)
        };
        let Some(base) = all_joints(self.document).filter(is_base).find(is_before) else { return Ok(None) };
        let origins = self.path(base).into_iter().map(|joint| self.origin(joint));
        origins
            .collect::<Result<Vec<_>, _>>()
            .map(|origins| Some(origins.iter().fold(Pose::identity(), |frame, next| frame.then(next))))
    }

    /// Refuses an arm that has further joints: the first six joints of an arm with seven are another robot. The joints
    /// of a gripper come further as well, and look like those of an arm.
    fn check_ends(&self, joints: &[UrdfJoint<'_>]) -> Result<(), Diagnostic> {
        let Some(sixth) = joints.last().map(|joint| joint.node) else { return Ok(()) };
        let is_behind = |joint: &Node<'_, '_>| *joint != sixth && self.path(*joint).contains(&sixth);
        let behind: Vec<&str> =
            all_joints(self.document).filter(|joint| movable(*joint)).filter(is_behind).map(name).collect();
        let finding = || MoreJoints { sixth: name(sixth).into(), joints: behind.join(", ") };
        if behind.is_empty() { Ok(()) } else { Err(self.refused(sixth, finding())) }
    }

    /// The end of the arm in the frame of the last joint: the best known link that is fixed to it, else the link of the joint.
    fn end(&self, joints: &[UrdfJoint<'_>]) -> Result<Pose, Diagnostic> {
        let Some(last) = joints.last().and_then(|joint| link(joint.node, "child")) else {
            return Ok(Pose::identity());
        };
        // The links that are fixed to the last one, with their places, breadth first.
        let mut fixed = vec![(last, Pose::identity())];
        let mut at = 0;
        while let Some((parent, frame)) = fixed.get(at).copied() {
            at += 1;
            for joint in all_joints(self.document).filter(|joint| !movable(*joint)) {
                let (from, to) = (link(joint, "parent"), link(joint, "child"));
                if let Some(to) =
                    to.filter(|to| from == Some(parent) && fixed.iter().all(|known| known.0 != *to))
                {
                    fixed.push((to, frame.then(&self.origin(joint)?)));
                }
            }
        }
        let end = ENDS.iter().find_map(|end| fixed.iter().find(|(link, _)| link.ends_with(end)));
        Ok(end.map_or_else(Pose::identity, |(_, frame)| *frame))
    }

    fn limits(&self, joint: &UrdfJoint<'_>) -> Result<JointLimits, Diagnostic> {
        let limit = child(joint.node, "limit");
        let number = |attribute: &str| -> Result<Option<f64>, Diagnostic> {
            let Some(node) = limit else { return Ok(None) };
            let Some(text) = node.attribute(attribute) else { return Ok(None) };
            let value = text.trim().parse().ok().filter(|value: &f64| value.is_finite());
            value.map(|value| Some(value.to_degrees())).ok_or_else(|| {
                self.refused(node, DescriptionFinding::NotNumber { attribute: attribute.into() })
            })
        };
        let (lower, upper) = (number("lower")?, number("upper")?);
        let deg = match (kind(joint.node), lower, upper) {
            ("revolute", Some(lower), Some(upper)) if lower < upper => [lower, upper],
            _ => [-ENDLESS_DEG, ENDLESS_DEG],
        };
        let deg_s = number("velocity")?.filter(|speed| *speed > 0.0).unwrap_or(USUAL_SPEED_DEG_S);
        Ok(JointLimits { deg, deg_s })
    }
}
