//! Values of RAPID's data types: targets, tools, work objects, speeds.

use crate::program::CompensationFinding;
use crate::program::Target;
use crate::program::compensate::External;
use crate::program::script::value::{Content, Value};
use dbbd_model::robot::Pose;

/// The target of a `jointtarget` `[[rax_1,..,rax_6],[..]]` or of a `robtarget`
/// `[[x,y,z],[q1,q2,q3,q4],[cf1,cf4,cf6,cfx],[..]]` with its configuration.
pub(super) fn taught(value: &Value) -> Option<(Target, Option<[i32; 4]>)> {
    match value.list()? {
        [axes, _] => Some((Target::Axes(axes.numbers()?), None)),
        [position, orientation, configuration, _] => {
            let pose = Pose::from_quaternion(position.numbers()?, quaternion(orientation)?)?;
            let quadrants: [f64; 4] = configuration.numbers()?;
            Some((Target::pose(&pose), Some(quadrants.map(|part| part as i32))))
        }
        _ => None,
    }
}

/// The components of RAPID's data types: name, number of components of the type, index. No type of one size has two components with
/// one name elsewhere.
const COMPONENTS: &[(&str, usize, usize)] = &[
    // pos, orient, pose
    ("X", 3, 0),
    ("Y", 3, 1),
    ("Z", 3, 2),
    ("Q1", 4, 0),
    ("Q2", 4, 1),
    ("Q3", 4, 2),
    ("Q4", 4, 3),
    ("TRANS", 2, 0),
    ("ROT", 2, 1),
    // robtarget, jointtarget
    ("TRANS", 4, 0),
    ("ROT", 4, 1),
    ("ROBCONF", 4, 2),
    ("EXTAX", 4, 3),
    ("ROBAX", 2, 0),
    ("EXTAX", 2, 1),
    // confdata, robjoint, extjoint
    ("CF1", 4, 0),
    ("CF4", 4, 1),
    ("CF6", 4, 2),
    ("CFX", 4, 3),
    ("RAX_1", 6, 0),
    ("RAX_2", 6, 1),
    ("RAX_3", 6, 2),
    ("RAX_4", 6, 3),
    ("RAX_5", 6, 4),
    ("RAX_6", 6, 5),
    ("EAX_A", 6, 0),
    ("EAX_B", 6, 1),
    ("EAX_C", 6, 2),
    ("EAX_D", 6, 3),
    ("EAX_E", 6, 4),
    ("EAX_F", 6, 5),
    // tooldata, wobjdata
    ("ROBHOLD", 3, 0),
    ("TFRAME", 3, 1),
    ("TLOAD", 3, 2),
    ("ROBHOLD", 5, 0),
    ("UFPROG", 5, 1),
    ("UFMEC", 5, 2),
    ("UFRAME", 5, 3),
    ("OFRAME", 5, 4),
    // loaddata
    ("MASS", 6, 0),
    ("COG", 6, 1),
    ("AOM", 6, 2),
    ("IX", 6, 3),
    ("IY", 6, 4),
    ("IZ", 6, 5),
];

/// The place of a component, given by the names after the dots; `None` if the value has no such component.
pub(super) fn component<'v>(value: &'v mut Value, names: &[String]) -> Option<&'v mut Value> {
    let Some((name, inner)) = names.split_first() else { return Some(value) };
    let parts = value.list()?.len();
    let (_, _, index) = COMPONENTS.iter().find(|(known, of, _)| known == name && *of == parts)?;
    component(value.part_mut(*index)?, inner)
}

/// The external axes of a `jointtarget` or `robtarget`.
pub(super) fn external(target: &Value) -> External {
    /// The value of an axis that the robot does not have.
    const ABSENT: f64 = 9e9;
    let axes: Option<[f64; 6]> = target.list().and_then(|parts| parts.last()?.numbers());
    axes.map_or([None; 6], |axes| axes.map(|at| (at != ABSENT).then_some(at)))
}

/// A quaternion; `None` if no controller accepts it because its norm is not 1.
fn quaternion(value: &Value) -> Option<[f64; 4]> {
    value.numbers().filter(|quaternion| is_unit(norm(quaternion)))
}

fn norm(quaternion: &[f64; 4]) -> f64 {
    quaternion.iter().map(|part| part * part).sum::<f64>().sqrt()
}

fn is_unit(norm: f64) -> bool {
    const ROUNDED: f64 = 0.01;
    (norm - 1.0).abs() < ROUNDED
}

/// The finding if the quaternion of a `robtarget` is not of unit length.
pub(super) fn not_of_unit_length(value: &Value) -> Option<CompensationFinding> {
    let [_, orientation, _, _] = value.list()? else { return None };
    let norm = norm(&orientation.numbers()?);
    let name = value.name.clone().unwrap_or_else(|| "inline".into());
    (!is_unit(norm)).then_some(CompensationFinding::PointNorm { name, norm })
}

/// `[[x,y,z],[q1,q2,q3,q4]]`
fn pose(value: &Value) -> Option<Pose> {
    match value.list()? {
        [position, orientation] => Pose::from_quaternion(position.numbers()?, quaternion(orientation)?),
        _ => None,
    }
}

/// The part of the cell on which a tool or work object is mounted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Holder {
    Robot,
    World,
    /// A mechanical unit such as a positioner, for a work object.
    MechanicalUnit,
}

fn holder(robhold: &Value) -> Option<Holder> {
    Some(if robhold.bool()? { Holder::Robot } else { Holder::World })
}

/// The holder and the frame of a `tooldata`.
pub(super) fn tool(value: &Value) -> Option<(Holder, Pose)> {
    match value.list()? {
        [robhold, frame, _] => Some((holder(robhold)?, pose(frame)?)),
        _ => None,
    }
}

/// The holder and the frame of a `wobjdata`: its object frame in its user frame.
pub(super) fn work_object(value: &Value) -> Option<(Holder, Pose)> {
    match value.list()? {
        [robhold, ufprog, _, user, object] => {
            let frame = pose(user)?.then(&pose(object)?);
            let is_moved = ufprog.bool() == Some(false);
            Some((if is_moved { Holder::MechanicalUnit } else { holder(robhold)? }, frame))
        }
        _ => None,
    }
}

/// The speed of the tool point, mm/s, and of the orientation, degrees/s, of a `speeddata`.
pub(super) fn speed(value: &Value) -> Option<[f64; 2]> {
    let [mm_s, deg_s, _, _]: [f64; 4] = value.numbers()?;
    Some([mm_s, deg_s])
}

/// Data that every controller has, by the name in capitals: `tool0`, `wobj0` and the speeds `v5` to `v7000`.
pub(super) fn predefined(name: &str) -> Option<Value> {
    let value = |content| Value { file: usize::MAX, span: 0..0, name: None, content };
    let bool = |truth| value(Content::Bool(truth));
    let list = |list| value(Content::List(list));
    let numbers =
        |numbers: &[f64]| list(numbers.iter().map(|number| value(Content::Number(*number))).collect());
    let null_frame = || list(vec![numbers(&[0.0; 3]), numbers(&[1.0, 0.0, 0.0, 0.0])]);
    match name {
        "TOOL0" => Some(list(vec![bool(true), null_frame(), numbers(&[])])),
        "WOBJ0" => {
            let unit = value(Content::Text(String::new()));
            Some(list(vec![bool(false), bool(true), unit, null_frame(), null_frame()]))
        }
        _ => {
            let mm_s: f64 = name.strip_prefix('V')?.parse().ok()?;
            let known = [5, 10, 20, 30, 40, 50, 60, 80, 100, 150, 200, 300, 400, 500, 600, 800, 1000, 1500];
            let fast = [2000, 2500, 3000, 4000, 5000, 6000, 7000];
            let is_known = known.iter().chain(&fast).any(|speed| f64::from(*speed) == mm_s);
            is_known.then(|| numbers(&[mm_s, 500.0, 5000.0, 1000.0]))
        }
    }
}
