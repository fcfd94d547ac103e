//! The messages of Foxglove that hold a moving scene, as Protobuf: `foxglove.FrameTransforms` and `foxglove.SceneUpdate`, m.
//!
//! Field numbers are those of <https://docs.foxglove.dev/docs/sdk/schemas>. The structs have the fields that are written here, the
//! descriptor has all that a reader expects of a message.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet, Timestamp,
};

pub(super) const FRAME_TRANSFORMS: &str = "foxglove.FrameTransforms";
pub(super) const SCENE_UPDATE: &str = "foxglove.SceneUpdate";

#[derive(Clone, PartialEq, Message)]
pub(super) struct SceneVector {
    #[prost(double, tag = "1")]
    pub x: f64,
    #[prost(double, tag = "2")]
    pub y: f64,
    #[prost(double, tag = "3")]
    pub z: f64,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct SceneRotation {
    #[prost(double, tag = "1")]
    pub x: f64,
    #[prost(double, tag = "2")]
    pub y: f64,
    #[prost(double, tag = "3")]
    pub z: f64,
    #[prost(double, tag = "4")]
    pub w: f64,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct ScenePose {
    #[prost(message, optional, tag = "1")]
    pub position: Option<SceneVector>,
    #[prost(message, optional, tag = "2")]
    pub orientation: Option<SceneRotation>,
}

/// 0 to 1.
#[derive(Clone, PartialEq, Message)]
pub(super) struct SceneColour {
    #[prost(double, tag = "1")]
    pub r: f64,
    #[prost(double, tag = "2")]
    pub g: f64,
    #[prost(double, tag = "3")]
    pub b: f64,
    #[prost(double, tag = "4")]
    pub a: f64,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct FrameTransform {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub parent_frame_id: String,
    #[prost(string, tag = "3")]
    pub child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    pub translation: Option<SceneVector>,
    #[prost(message, optional, tag = "5")]
    pub rotation: Option<SceneRotation>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct FrameTransforms {
    #[prost(message, repeated, tag = "1")]
    pub transforms: Vec<FrameTransform>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct SpherePrimitive {
    #[prost(message, optional, tag = "1")]
    pub pose: Option<ScenePose>,
    #[prost(message, optional, tag = "2")]
    pub size: Option<SceneVector>,
    #[prost(message, optional, tag = "3")]
    pub colour: Option<SceneColour>,
}

/// Its type is 0: a strip from point to point.
#[derive(Clone, PartialEq, Message)]
pub(super) struct LinePrimitive {
    #[prost(message, optional, tag = "2")]
    pub pose: Option<ScenePose>,
    #[prost(double, tag = "3")]
    pub thickness: f64,
    #[prost(message, repeated, tag = "5")]
    pub points: Vec<SceneVector>,
    #[prost(message, optional, tag = "6")]
    pub colour: Option<SceneColour>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct SceneEntity {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub frame_id: String,
    #[prost(string, tag = "3")]
    pub id: String,
    #[prost(message, repeated, tag = "9")]
    pub spheres: Vec<SpherePrimitive>,
    #[prost(message, repeated, tag = "11")]
    pub lines: Vec<LinePrimitive>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct SceneUpdate {
    #[prost(message, repeated, tag = "2")]
    pub entities: Vec<SceneEntity>,
}

/// What a field holds.
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

/// The types of both channels, as MCAP keeps them: a serialised set of files, each after those that it needs.
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
