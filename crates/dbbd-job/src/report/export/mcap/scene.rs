//! The cell of a run in three dimensions: the links of the robot as it was commanded or measured, the balls and the bar, in Foxglove's
//! messages `foxglove.FrameTransforms` and `foxglove.SceneUpdate` (Protobuf, m).
//!
//! The field numbers are from <https://docs.foxglove.dev/docs/sdk/schemas>. The structs have only the fields that are
//! written here; the descriptor has all fields that a reader expects of a message.

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet, Timestamp,
};

use crate::recording::matching::PoseMatching;
use crate::recording::run::RecordedRun;
use crate::report::export::urdf::{link_frames, urdf};
use dbbd_model::base::units::HostNs;
use dbbd_model::measurement::{BallId, BaseBall};
use dbbd_model::robot::{AXES, Pose, Robot};

/// Frame of the robot base; the links have their names in the URDF.
const BASE: &str = "base_link";
/// Axes that are published faster are drawn at this interval, ns: 20 times a second.
const AXES_INTERVAL_NS: u64 = 50_000_000;
/// Drawn sizes of a ball of the bar and of the bar, m; they are not the real sizes.
const BALL_M: f64 = 0.025;
const BAR_M: f64 = 0.008;

/// The robot at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ShownPose {
    host: HostNs,
    axes_deg: [f64; AXES],
    /// The base ball on which the bar is.
    ball: BallId,
}

/// The content of a scene: the robot as its controller knows it, the balls, and the dwells.
pub struct RunScene {
    robot: Robot,
    balls: Vec<BaseBall>,
    /// Beginning and end of each dwell that matched a pose, in time order.
    dwells: Vec<ShownPose>,
    /// Dwells that have been shown already.
    shown: usize,
    ball: BallId,
    last_axes: Option<HostNs>,
}

/// A message of each channel, as Protobuf.
pub(super) struct SceneMessages {
    pub(super) transforms: Vec<u8>,
    pub(super) update: Vec<u8>,
}

impl RunScene {
    /// The scene of a run whose poses were matched.
    pub fn of(run: &RecordedRun, robot: &Robot, matching: &PoseMatching) -> Self {
        let of_index = |index: u32| run.plan.rows.iter().find(|row| row.index == index);
        let mut dwells: Vec<ShownPose> = Vec::new();
        for outcome in &matching.outcomes {
            let Some((reading, row)) = outcome.reading().zip(of_index(outcome.index)) else { continue };
            for t_s in [reading.from_s, reading.to_s] {
                let host = run.stream.host_at(t_s);
                dwells.push(ShownPose { host, axes_deg: row.axes_deg, ball: row.centre });
            }
        }
        dwells.sort_by_key(|pose| pose.host);
        let balls = run.centres();
        let ball = dwells.first().map_or(BallId::at(0), |pose| pose.ball);
        Self { robot: robot.controller().clone(), balls, dwells, shown: 0, ball, last_axes: None }
    }

    /// The robot for a viewer that draws its links.
    pub(super) fn urdf(&self) -> String {
        urdf(&self.robot)
    }

    /// The dwells up to a time that were not returned yet.
    pub(super) fn dwells_until(&mut self, host: HostNs) -> Vec<(HostNs, [f64; AXES])> {
        let due: Vec<ShownPose> =
            self.dwells[self.shown..].iter().copied().take_while(|pose| pose.host <= host).collect();
        self.shown += due.len();
        self.ball = due.last().map_or(self.ball, |pose| pose.ball);
        due.into_iter().map(|pose| (pose.host, pose.axes_deg)).collect()
    }

    /// Whether axes that were published at this time are drawn.
    pub(super) fn draws_axes(&mut self, host: HostNs) -> bool {
        let is_due = self.last_axes.is_none_or(|last| host.0 >= last.0.saturating_add(AXES_INTERVAL_NS));
        self.last_axes = if is_due { Some(host) } else { self.last_axes };
        is_due
    }

    /// The robot, the balls and the bar at axis angles, at a time of the wall clock in ns.
    pub(super) fn messages(&self, axes_deg: &[f64; AXES], at_ns: u64) -> SceneMessages {
        let axes = axes_deg.map(f64::to_radians);
        let timestamp = timestamp(at_ns);
        let links = link_frames(&self.robot, &axes);
        let transform = |(name, pose): &(String, Pose)| FrameTransform {
            timestamp: Some(timestamp),
            parent_frame_id: BASE.into(),
            child_frame_id: name.clone(),
            translation: Some(metres(&pose.position)),
            rotation: Some(quaternion(pose)),
        };
        let tool_ball = self.robot.geometry.rigid().ball(&axes).position;
        let entity = |id: &str, spheres, lines| SceneEntity {
            timestamp: Some(timestamp),
            frame_id: BASE.into(),
            id: id.into(),
            spheres,
            lines,
        };
        let on = self.balls.iter().find(|ball| ball.id == self.ball);
        let bar = on.map(|ball| LinePrimitive {
            pose: Some(placed(&Vector3::zeros())),
            thickness: BAR_M,
            points: vec![metres(&ball.position), metres(&tool_ball)],
            colour: Some(SceneColour { r: 0.2, g: 0.4, b: 0.9, a: 1.0 }),
        });
        let balls = self.balls.iter().map(|ball| sphere(&ball.position)).collect();
        let transforms = FrameTransforms { transforms: links.iter().map(transform).collect() };
        let bar = entity("bar", vec![sphere(&tool_ball)], bar.into_iter().collect());
        let update = SceneUpdate { entities: vec![entity("base balls", balls, Vec::new()), bar] };
        SceneMessages { transforms: transforms.encode_to_vec(), update: update.encode_to_vec() }
    }
}

fn timestamp(at_ns: u64) -> Timestamp {
    const SECOND_NS: u64 = 1_000_000_000;
    Timestamp { seconds: (at_ns / SECOND_NS) as i64, nanos: (at_ns % SECOND_NS) as i32 }
}

/// A place in mm as a vector in m.
fn metres(mm: &Vector3<f64>) -> SceneVector {
    let [x, y, z] = (mm * 1e-3).into();
    SceneVector { x, y, z }
}

fn quaternion(pose: &Pose) -> SceneRotation {
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(pose.rotation));
    let [x, y, z, w] = turn.into_inner().coords.into();
    SceneRotation { x, y, z, w }
}

fn placed(mm: &Vector3<f64>) -> ScenePose {
    ScenePose {
        position: Some(metres(mm)),
        orientation: Some(SceneRotation { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
    }
}

fn sphere(mm: &Vector3<f64>) -> SpherePrimitive {
    SpherePrimitive {
        pose: Some(placed(mm)),
        size: Some(SceneVector { x: BALL_M, y: BALL_M, z: BALL_M }),
        colour: Some(SceneColour { r: 0.9, g: 0.5, b: 0.1, a: 1.0 }),
    }
}

pub(super) const FRAME_TRANSFORMS: &str = "foxglove.FrameTransforms";
pub(super) const SCENE_UPDATE: &str = "foxglove.SceneUpdate";

#[derive(Clone, PartialEq, Message)]
struct SceneVector {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
}

#[derive(Clone, PartialEq, Message)]
struct SceneRotation {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
    #[prost(double, tag = "4")]
    w: f64,
}

#[derive(Clone, PartialEq, Message)]
struct ScenePose {
    #[prost(message, optional, tag = "1")]
    position: Option<SceneVector>,
    #[prost(message, optional, tag = "2")]
    orientation: Option<SceneRotation>,
}

/// A colour; each part is 0 to 1.
#[derive(Clone, PartialEq, Message)]
struct SceneColour {
    #[prost(double, tag = "1")]
    r: f64,
    #[prost(double, tag = "2")]
    g: f64,
    #[prost(double, tag = "3")]
    b: f64,
    #[prost(double, tag = "4")]
    a: f64,
}

#[derive(Clone, PartialEq, Message)]
struct FrameTransform {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    parent_frame_id: String,
    #[prost(string, tag = "3")]
    child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    translation: Option<SceneVector>,
    #[prost(message, optional, tag = "5")]
    rotation: Option<SceneRotation>,
}

#[derive(Clone, PartialEq, Message)]
struct FrameTransforms {
    #[prost(message, repeated, tag = "1")]
    transforms: Vec<FrameTransform>,
}

#[derive(Clone, PartialEq, Message)]
struct SpherePrimitive {
    #[prost(message, optional, tag = "1")]
    pose: Option<ScenePose>,
    #[prost(message, optional, tag = "2")]
    size: Option<SceneVector>,
    #[prost(message, optional, tag = "3")]
    colour: Option<SceneColour>,
}

/// A line. Its field `type` is 0: a strip from point to point.
#[derive(Clone, PartialEq, Message)]
struct LinePrimitive {
    #[prost(message, optional, tag = "2")]
    pose: Option<ScenePose>,
    #[prost(double, tag = "3")]
    thickness: f64,
    #[prost(message, repeated, tag = "5")]
    points: Vec<SceneVector>,
    #[prost(message, optional, tag = "6")]
    colour: Option<SceneColour>,
}

#[derive(Clone, PartialEq, Message)]
struct SceneEntity {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(string, tag = "3")]
    id: String,
    #[prost(message, repeated, tag = "9")]
    spheres: Vec<SpherePrimitive>,
    #[prost(message, repeated, tag = "11")]
    lines: Vec<LinePrimitive>,
}

#[derive(Clone, PartialEq, Message)]
struct SceneUpdate {
    #[prost(message, repeated, tag = "2")]
    entities: Vec<SceneEntity>,
}

/// The content of a field.
#[derive(Clone, Copy)]
enum FieldKind {
    Double,
    Truth,
    Text,
    Bytes,
    /// Indices, 32 bits each.
    Indices,
    /// One message of this type, or several.
    One(&'static str),
    Many(&'static str),
    /// An enum of the message.
    Choice(&'static str),
}

use FieldKind::{Bytes, Choice, Double, Indices, Many, One, Text, Truth};

const TIME: FieldKind = One(".google.protobuf.Timestamp");
const POSE: FieldKind = One(".foxglove.Pose");
const VECTOR: FieldKind = One(".foxglove.Vector3");
const COLOUR: FieldKind = One(".foxglove.Color");
const POINTS: FieldKind = Many(".foxglove.Point3");

/// A message with its fields: name, number, content.
type MessageType = (&'static str, &'static [(&'static str, i32, FieldKind)]);

const MESSAGES: &[MessageType] = &[
    ("Vector3", &[("x", 1, Double), ("y", 2, Double), ("z", 3, Double)]),
    ("Point3", &[("x", 1, Double), ("y", 2, Double), ("z", 3, Double)]),
    ("Quaternion", &[("x", 1, Double), ("y", 2, Double), ("z", 3, Double), ("w", 4, Double)]),
    ("Color", &[("r", 1, Double), ("g", 2, Double), ("b", 3, Double), ("a", 4, Double)]),
    ("Pose", &[("position", 1, VECTOR), ("orientation", 2, One(".foxglove.Quaternion"))]),
    ("KeyValuePair", &[("key", 1, Text), ("value", 2, Text)]),
    (
        "FrameTransform",
        &[
            ("timestamp", 1, TIME),
            ("parent_frame_id", 2, Text),
            ("child_frame_id", 3, Text),
            ("translation", 4, VECTOR),
            ("rotation", 5, One(".foxglove.Quaternion")),
        ],
    ),
    ("FrameTransforms", &[("transforms", 1, Many(".foxglove.FrameTransform"))]),
    (
        "ArrowPrimitive",
        &[
            ("pose", 1, POSE),
            ("shaft_length", 2, Double),
            ("shaft_diameter", 3, Double),
            ("head_length", 4, Double),
            ("head_diameter", 5, Double),
            ("color", 6, COLOUR),
        ],
    ),
    ("CubePrimitive", &[("pose", 1, POSE), ("size", 2, VECTOR), ("color", 3, COLOUR)]),
    ("SpherePrimitive", &[("pose", 1, POSE), ("size", 2, VECTOR), ("color", 3, COLOUR)]),
    (
        "CylinderPrimitive",
        &[
            ("pose", 1, POSE),
            ("size", 2, VECTOR),
            ("bottom_scale", 3, Double),
            ("top_scale", 4, Double),
            ("color", 5, COLOUR),
        ],
    ),
    (
        "LinePrimitive",
        &[
            ("type", 1, Choice("LINE_STRIP LINE_LOOP LINE_LIST")),
            ("pose", 2, POSE),
            ("thickness", 3, Double),
            ("scale_invariant", 4, Truth),
            ("points", 5, POINTS),
            ("color", 6, COLOUR),
            ("colors", 7, Many(".foxglove.Color")),
            ("indices", 8, Indices),
        ],
    ),
    (
        "TriangleListPrimitive",
        &[
            ("pose", 1, POSE),
            ("points", 2, POINTS),
            ("color", 3, COLOUR),
            ("colors", 4, Many(".foxglove.Color")),
            ("indices", 5, Indices),
        ],
    ),
    (
        "TextPrimitive",
        &[
            ("pose", 1, POSE),
            ("billboard", 2, Truth),
            ("font_size", 3, Double),
            ("scale_invariant", 4, Truth),
            ("color", 5, COLOUR),
            ("text", 6, Text),
        ],
    ),
    (
        "ModelPrimitive",
        &[
            ("pose", 1, POSE),
            ("scale", 2, VECTOR),
            ("color", 3, COLOUR),
            ("override_color", 4, Truth),
            ("url", 5, Text),
            ("media_type", 6, Text),
            ("data", 7, Bytes),
        ],
    ),
    (
        "SceneEntityDeletion",
        &[("timestamp", 1, TIME), ("type", 2, Choice("MATCHING_ID ALL")), ("id", 3, Text)],
    ),
    (
        "SceneEntity",
        &[
            ("timestamp", 1, TIME),
            ("frame_id", 2, Text),
            ("id", 3, Text),
            ("lifetime", 4, One(".google.protobuf.Duration")),
            ("frame_locked", 5, Truth),
            ("metadata", 6, Many(".foxglove.KeyValuePair")),
            ("arrows", 7, Many(".foxglove.ArrowPrimitive")),
            ("cubes", 8, Many(".foxglove.CubePrimitive")),
            ("spheres", 9, Many(".foxglove.SpherePrimitive")),
            ("cylinders", 10, Many(".foxglove.CylinderPrimitive")),
            ("lines", 11, Many(".foxglove.LinePrimitive")),
            ("triangles", 12, Many(".foxglove.TriangleListPrimitive")),
            ("texts", 13, Many(".foxglove.TextPrimitive")),
            ("models", 14, Many(".foxglove.ModelPrimitive")),
        ],
    ),
    (
        "SceneUpdate",
        &[
            ("deletions", 1, Many(".foxglove.SceneEntityDeletion")),
            ("entities", 2, Many(".foxglove.SceneEntity")),
        ],
    ),
];

/// The types of both channels, as MCAP keeps them: a serialised set of files, each after the files that it needs.
pub(super) fn schema() -> Vec<u8> {
    let of_google = |name: &str, message: &str| {
        let field = |(name, number, kind): (&str, i32, Type)| FieldDescriptorProto {
            name: Some(name.into()),
            number: Some(number),
            label: Some(Label::Optional.into()),
            r#type: Some(kind.into()),
            ..FieldDescriptorProto::default()
        };
        FileDescriptorProto {
            name: Some(name.into()),
            package: Some("google.protobuf".into()),
            message_type: vec![DescriptorProto {
                name: Some(message.into()),
                field: [("seconds", 1, Type::Int64), ("nanos", 2, Type::Int32)].map(field).into(),
                ..DescriptorProto::default()
            }],
            syntax: Some("proto3".into()),
            ..FileDescriptorProto::default()
        }
    };
    const TIMESTAMP: &str = "google/protobuf/timestamp.proto";
    const DURATION: &str = "google/protobuf/duration.proto";
    let foxglove = FileDescriptorProto {
        name: Some("foxglove/scene.proto".into()),
        package: Some("foxglove".into()),
        dependency: [TIMESTAMP, DURATION].map(str::to_owned).into(),
        message_type: MESSAGES.iter().map(message_type).collect(),
        syntax: Some("proto3".into()),
        ..FileDescriptorProto::default()
    };
    let file = vec![of_google(TIMESTAMP, "Timestamp"), of_google(DURATION, "Duration"), foxglove];
    FileDescriptorSet { file }.encode_to_vec()
}

fn message_type((name, fields): &MessageType) -> DescriptorProto {
    let choices = fields.iter().filter_map(|(_, _, kind)| match kind {
        Choice(values) => Some(choice(values)),
        Double | Truth | Text | Bytes | Indices | One(_) | Many(_) => None,
    });
    DescriptorProto {
        name: Some((*name).into()),
        field: fields.iter().map(|field| descriptor(name, field)).collect(),
        enum_type: choices.collect(),
        ..DescriptorProto::default()
    }
}

fn descriptor(message: &str, (name, number, kind): &(&str, i32, FieldKind)) -> FieldDescriptorProto {
    let (kind_of_value, type_name, is_list) = match *kind {
        Double => (Type::Double, None, false),
        Truth => (Type::Bool, None, false),
        Text => (Type::String, None, false),
        Bytes => (Type::Bytes, None, false),
        Indices => (Type::Fixed32, None, true),
        One(of) => (Type::Message, Some(of.to_owned()), false),
        Many(of) => (Type::Message, Some(of.to_owned()), true),
        Choice(_) => (Type::Enum, Some(format!(".foxglove.{message}.Type")), false),
    };
    FieldDescriptorProto {
        name: Some((*name).into()),
        number: Some(*number),
        label: Some(if is_list { Label::Repeated } else { Label::Optional }.into()),
        r#type: Some(kind_of_value.into()),
        type_name,
        ..FieldDescriptorProto::default()
    }
}

/// The enum `Type` of a message, with its values from 0.
fn choice(values: &str) -> EnumDescriptorProto {
    let value = |(number, name): (i32, &str)| EnumValueDescriptorProto {
        name: Some(name.into()),
        number: Some(number),
        options: None,
    };
    EnumDescriptorProto {
        name: Some("Type".into()),
        value: (0..).zip(values.split(' ')).map(value).collect(),
        ..EnumDescriptorProto::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Every type that a field names is in the set, and no number is used twice.
    #[test]
    fn the_schema_is_closed() {
        let set = FileDescriptorSet::decode(&schema()[..]).unwrap();
        let of_file = |file: &FileDescriptorProto| {
            let package = file.package().to_owned();
            let messages = file.message_type.clone().into_iter();
            messages.flat_map(move |message| {
                let name = format!(".{package}.{}", message.name());
                let enums = message.enum_type.iter().map(|choice| format!("{name}.{}", choice.name()));
                enums.chain([name.clone()]).collect::<Vec<_>>()
            })
        };
        let known: BTreeSet<String> = set.file.iter().flat_map(of_file).collect();
        for message in set.file.iter().flat_map(|file| &file.message_type) {
            let numbers: BTreeSet<i32> = message.field.iter().map(FieldDescriptorProto::number).collect();
            assert_eq!(numbers.len(), message.field.len(), "{}", message.name());
            for field in message.field.iter().filter(|field| field.type_name.is_some()) {
                assert!(known.contains(field.type_name()), "{} {}", message.name(), field.name());
            }
        }
        for name in [FRAME_TRANSFORMS, SCENE_UPDATE] {
            assert!(known.contains(&format!(".{name}")));
        }
    }
}
