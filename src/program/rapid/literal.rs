//! What RAPID's data say: targets, tools, work objects, speeds.

use crate::program::Target;
use crate::program::script::value::{Of, Value};
use crate::robot::Pose;

/// A `robtarget` or a `jointtarget`, external axes left aside.
pub(super) struct Taught {
    pub(super) target: Target,
    /// Of a `robtarget`.
    pub(super) configuration: Option<[i32; 4]>,
}

/// `[[x,y,z],[q1,q2,q3,q4],[cf1,cf4,cf6,cfx],[..]]` or `[[rax_1,..,rax_6],[..]]`
pub(super) fn taught(value: &Value) -> Option<Taught> {
    match value.list()? {
        [axes, _] => Some(Taught { target: Target::Axes(axes.numbers()?), configuration: None }),
        [place, turn, configuration, _] => {
            let pose = Pose::from_quaternion(place.numbers()?, normed(turn)?)?;
            let quadrants: [f64; 4] = configuration.numbers()?;
            let target = Target::Pose {
                xyz_mm: pose.position.into(),
                abc_deg: pose.abc_deg(),
                status: None,
                turn: None,
            };
            Some(Taught { target, configuration: Some(quadrants.map(|part| part as i32)) })
        }
        _ => None,
    }
}

/// A quaternion; `None` of one that no controller takes, as it is not normed.
fn normed(turn: &Value) -> Option<[f64; 4]> {
    const ROUNDED: f64 = 0.01;
    let turn: [f64; 4] = turn.numbers()?;
    let norm = turn.iter().map(|part| part * part).sum::<f64>().sqrt();
    ((norm - 1.0).abs() < ROUNDED).then_some(turn)
}

/// `[[x,y,z],[q1,q2,q3,q4]]`
fn pose(value: &Value) -> Option<Pose> {
    match value.list()? {
        [place, turn] => Pose::from_quaternion(place.numbers()?, normed(turn)?),
        _ => None,
    }
}

/// Where a tool or a work object is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Held {
    ByRobot,
    Fixed,
    /// By a mechanical unit, of a work object.
    ByUnit,
}

fn held(value: &Value) -> Option<Held> {
    match value.of {
        Of::Bool(true) => Some(Held::ByRobot),
        Of::Bool(false) => Some(Held::Fixed),
        _ => None,
    }
}

/// The frame of a `tooldata` in the flange frame, and who holds the tool.
pub(super) fn tool(value: &Value) -> Option<(Held, Pose)> {
    match value.list()? {
        [hold, frame, _] => Some((held(hold)?, pose(frame)?)),
        _ => None,
    }
}

/// The frame of a `wobjdata` in the robot's base: user frame and object frame; and who holds the workpiece.
pub(super) fn work_object(value: &Value) -> Option<(Held, Pose)> {
    match value.list()? {
        [hold, is_fixed, _, user, object] => {
            let frame = pose(user)?.then(&pose(object)?);
            Some((if is_fixed.of == Of::Bool(false) { Held::ByUnit } else { held(hold)? }, frame))
        }
        _ => None,
    }
}

/// Speed of the tool point, mm/s, and of the orientation, degrees/s, of a `speeddata`.
pub(super) fn speed(value: &Value) -> Option<[f64; 2]> {
    let [mm_s, deg_s, _, _]: [f64; 4] = value.numbers()?;
    Some([mm_s, deg_s])
}

/// Data that every controller has: `tool0`, `wobj0` and the speeds `v5` to `v7000`; the name in capitals.
pub(super) fn predefined(name: &str) -> Option<Value> {
    let number = |value: f64| made(Of::Number(value));
    let list = |values: &[f64]| made(Of::List(values.iter().map(|value| number(*value)).collect()));
    let null = || made(Of::List(vec![list(&[0.0; 3]), list(&[1.0, 0.0, 0.0, 0.0])]));
    let truth = |value: bool| made(Of::Bool(value));
    match name {
        "TOOL0" => Some(made(Of::List(vec![truth(true), null(), list(&[])]))),
        "WOBJ0" => {
            let text = made(Of::Text(String::new()));
            Some(made(Of::List(vec![truth(false), truth(true), text, null(), null()])))
        }
        _ => {
            let mm_s: f64 = name.strip_prefix('V')?.parse().ok()?;
            let known = [5, 10, 20, 30, 40, 50, 60, 80, 100, 150, 200, 300, 400, 500, 600, 800, 1000, 1500];
            let fast = [2000, 2500, 3000, 4000, 5000, 6000, 7000];
            let is_known = known.iter().chain(&fast).any(|speed| f64::from(*speed) == mm_s);
            is_known.then(|| list(&[mm_s, 500.0, 5000.0, 1000.0]))
        }
    }
}

fn made(of: Of) -> Value {
    Value { file: usize::MAX, span: 0..0, name: None, of }
}
