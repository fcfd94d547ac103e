//! The cell of a run in three dimensions: the links of the robot as it was commanded or measured, the balls and the bar.

use nalgebra::{Rotation3, UnitQuaternion, Vector3};

use super::foxglove::{
    FrameTransform, FrameTransforms, LinePrimitive, SceneColour, SceneEntity, ScenePose, SceneRotation,
    SceneUpdate, SceneVector, SpherePrimitive,
};
use crate::recording::matching::PoseMatching;
use crate::recording::run::RecordedRun;
use crate::report::export::urdf::{link_frames, urdf};
use dbbd_model::base::units::HostNs;
use dbbd_model::measurement::{BallId, BaseBall};
use dbbd_model::robot::{AXES, Pose, Robot};
use prost_types::Timestamp;

/// Frame of the robot base; the links have their names in the URDF.
const BASE: &str = "base_link";
/// Axes that are published faster are drawn at this interval, ns: 20 times a second.
const AXES_INTERVAL_NS: u64 = 50_000_000;
/// A ball of the bar, and the bar, m: what they look like, not what they are.
const BALL_M: f64 = 0.025;
const BAR_M: f64 = 0.008;

/// The robot at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ShownPose {
    host: HostNs,
    axes_deg: [f64; AXES],
    /// The base ball that the bar is on.
    ball: BallId,
}

/// What a run shows: its robot as its controller knows it, its balls, and where it dwelt.
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

/// A message of each channel.
pub(super) struct SceneMessages {
    pub(super) transforms: FrameTransforms,
    pub(super) update: SceneUpdate,
}

impl RunScene {
    /// Of a run whose poses were matched.
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

    /// The dwells up to a time that were not asked for yet.
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
        SceneMessages {
            transforms: FrameTransforms { transforms: links.iter().map(transform).collect() },
            update: SceneUpdate {
                entities: vec![
                    entity("base balls", balls, Vec::new()),
                    entity("bar", vec![sphere(&tool_ball)], bar.into_iter().collect()),
                ],
            },
        }
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
