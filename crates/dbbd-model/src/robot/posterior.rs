//! The posterior of an identification, as the file of the identified robot has it.

use nalgebra::{DMatrix, Vector3};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{BallId, Coordinate, Geometry, ParamId};

/// The values and covariance (root root', mm and rad) of the parameters of a robot. The coordinates of the base balls
/// follow the parameters of the robot, if the identification estimated them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotPosterior {
    #[serde(rename = "parameters")]
    ids: Vec<ParamId>,
    values: Vec<f64>,
    /// Root of the covariance: square and lower triangular, one row per parameter. The file has the triangle, row by
    /// row.
    #[serde(serialize_with = "write_root", deserialize_with = "read_root")]
    root: DMatrix<f64>,
}

/// A value of the robot file that differs by more, mm or rad, was changed after the identification.
const SAME: f64 = 1e-9;

impl RobotPosterior {
    /// The posterior of parameters of `geometry` with any root of the covariance (one row per parameter); `None` if a parameter
    /// is not one of the robot, or the covariance is singular.
    pub fn new(ids: &[ParamId], geometry: &Geometry, root: &DMatrix<f64>) -> Option<Self> {
        Self::with_balls(ids, geometry, &[], root)
    }

    /// As [`Self::new`], with base balls, whose coordinates follow the parameters of the robot.
    pub(crate) fn with_balls(
        ids: &[ParamId],
        geometry: &Geometry,
        balls: &[Vector3<f64>],
        root: &DMatrix<f64>,
    ) -> Option<Self> {
        let value = |id: &ParamId| {
            let ParamId::Ball(ball, axis) = id else { return geometry.value(*id) };
            balls.get(ball.index()).map(|place| place[axis.index()])
        };
        let values = ids.iter().map(value).collect::<Option<Vec<f64>>>()?;
        let root = triangular(root);
        let is_finite = root.is_square() && root.iter().all(|x| x.is_finite());
        (is_finite && root.diagonal().iter().all(|x| *x != 0.0)).then(|| Self {
            ids: ids.to_vec(),
            values,
            root,
        })
    }

    /// The parameters of the robot.
    pub fn ids(&self) -> &[ParamId] {
        let own = self.ids.iter().position(|id| is_ball(*id)).unwrap_or(self.ids.len());
        &self.ids[..own]
    }

    /// The parameters of the robot, then the coordinates of the base balls.
    pub(crate) fn all_ids(&self) -> &[ParamId] {
        &self.ids
    }

    /// The position of a base ball in the robot base, mm; `None` if it was not estimated.
    pub fn ball(&self, ball: BallId) -> Option<Vector3<f64>> {
        let value = |axis| Some(self.values[self.position(ParamId::Ball(ball, axis))?]);
        let [x, y, z] = Coordinate::ALL.map(value);
        Some(Vector3::new(x?, y?, z?))
    }

    fn position(&self, id: ParamId) -> Option<usize> {
        self.ids.iter().position(|own| *own == id)
    }

    /// Whether the posterior has the parameter values of this geometry.
    pub fn is_of(&self, geometry: &Geometry) -> bool {
        let same = |(id, value): (&ParamId, &f64)| {
            geometry.value(*id).is_some_and(|here| (here - value).abs() <= SAME)
        };
        self.ids().iter().zip(&self.values).all(same)
    }

    /// Standard deviation of a parameter, mm or rad.
    pub fn sd(&self, id: ParamId) -> Option<f64> {
        self.position(id).map(|at| self.root.row(at).norm())
    }

    /// The root of the covariance of some parameters, in the order of `ids`; square and lower triangular.
    pub(crate) fn root_of(&self, ids: &[ParamId]) -> DMatrix<f64> {
        let rows: Vec<usize> = ids.iter().filter_map(|id| self.position(*id)).collect();
        triangular(&self.root.select_rows(&rows))
    }

    /// Adds the variances of independent steps. A step moves several parameters together (mm or rad).
    pub(super) fn widen(&mut self, steps: &[Vec<(ParamId, f64)>]) {
        self.root = triangular(&with_steps(&self.root, &self.ids, steps));
    }

    /// Moves the value of a parameter, mm or rad, if the posterior has that parameter.
    pub(super) fn shift(&mut self, id: ParamId, by: f64) {
        if let Some(at) = self.position(id) {
            self.values[at] += by;
        }
    }

    /// The posterior of the parameters for which `keep` is true; `None` if there are none.
    pub fn keeping(&self, keep: impl Fn(ParamId) -> bool) -> Option<Self> {
        let kept = self.ids.iter().zip(&self.values).filter(|(id, _)| keep(**id));
        let (ids, values): (Vec<ParamId>, Vec<f64>) = kept.map(|(id, value)| (*id, *value)).unzip();
        (!ids.is_empty()).then(|| Self { root: self.root_of(&ids), ids, values })
    }

    /// Whether the parts are consistent and the numbers possible.
    pub(super) fn is_sound(&self) -> bool {
        let Self { ids, values, root } = self;
        !ids.is_empty()
            && values.len() == ids.len()
            && root.nrows() == ids.len()
            && root.diagonal().iter().all(|x| *x != 0.0)
            && root.iter().chain(values).all(|x| x.is_finite())
            && (1..ids.len()).all(|at| !ids[..at].contains(&ids[at]))
            && self.ids().iter().all(|id| id.is_geometric() || matches!(id, ParamId::Tool(_)))
            && ids.iter().skip(self.ids().len()).all(|id| is_ball(*id))
    }
}

fn is_ball(id: ParamId) -> bool {
    matches!(id, ParamId::Ball(..))
}

fn write_root<S: Serializer>(root: &DMatrix<f64>, to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq((0..root.nrows()).map(|at| (0..=at).map(|j| root[(at, j)]).collect::<Vec<f64>>()))
}

fn read_root<'de, D: Deserializer<'de>>(from: D) -> Result<DMatrix<f64>, D::Error> {
    let rows: Vec<Vec<f64>> = Vec::deserialize(from)?;
    // A root that is not triangular becomes NaN, which `is_sound` refuses.
    let is_triangular = rows.iter().enumerate().all(|(at, row)| row.len() == at + 1);
    let element = |row: usize, column: usize| rows[row].get(column).copied().unwrap_or(0.0);
    let of = |row, column| if is_triangular { element(row, column) } else { f64::NAN };
    Ok(DMatrix::from_fn(rows.len(), rows.len(), of))
}

/// The root of a covariance with a further column for each step. The first rows of `root` are those of `ids`. A column
/// has one standard deviation of each parameter of its step (mm or rad) that has a row.
pub(super) fn with_steps(
    root: &DMatrix<f64>,
    ids: &[ParamId],
    steps: &[Vec<(ParamId, f64)>],
) -> DMatrix<f64> {
    // A step of no size adds no column, so that nothing that is drawn from the root changes either.
    let steps: Vec<_> = steps.iter().filter(|step| step.iter().any(|(_, size)| *size != 0.0)).collect();
    let own = root.ncols();
    let mut wider = root.clone().resize_horizontally(own + steps.len(), 0.0);
    for (at, step) in steps.iter().enumerate() {
        for (id, size) in *step {
            if let Some(row) = ids.iter().position(|own| own == id) {
                wider[(row, own + at)] = *size;
            }
        }
    }
    wider
}

/// The lower triangular root of the same covariance.
fn triangular(root: &DMatrix<f64>) -> DMatrix<f64> {
    root.transpose().qr().r().transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Joint, Robot};

    #[test]
    fn posteriors_read_back_and_compare_their_values() {
        let mut robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let ids = [ParamId::A(Joint::J2), ParamId::Theta(Joint::J3), ParamId::D(Joint::J4)];
        let root = DMatrix::from_fn(3, 5, |i, j| ((5 * i + j) as f64).sin() * 1e-3);
        let posterior = RobotPosterior::new(&ids, &robot.geometry, &root).unwrap();
        let covariance = &root * root.transpose();
        let found = posterior.root_of(&ids);
        assert!((&found * found.transpose() - &covariance).norm() < 1e-12 * covariance.norm());
        let other = posterior.keeping(|id| id != ids[0]).unwrap();
        assert!((other.sd(ids[2]).unwrap().powi(2) - covariance[(2, 2)]).abs() < 1e-18);
        assert_eq!(other.sd(ids[0]), None);
        robot.posterior = Some(posterior);
        let read = Robot::from_toml("robot.toml", &robot.to_toml().unwrap()).unwrap();
        assert_eq!(read, robot);
        assert!(read.posterior.as_ref().unwrap().is_of(&read.geometry));
        robot.geometry.tool.x += 1.0;
        assert!(
            robot.posterior.as_ref().unwrap().is_of(&robot.geometry),
            "the tool is not one of its parameters"
        );
        *robot.geometry.value_mut(ids[0]).unwrap() += 1e-6;
        assert!(!robot.posterior.unwrap().is_of(&robot.geometry));
    }

    #[test]
    fn base_balls_follow_the_parameters_of_the_robot() {
        let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let ball = |axis| ParamId::Ball(BallId::at(1), axis);
        let [x, y, z] = Coordinate::ALL.map(ball);
        let ids = [ParamId::A(Joint::J2), x, y, z];
        let balls = [Vector3::zeros(), Vector3::new(1.0, -2.0, 3.0)];
        let root = DMatrix::from_row_slice(
            4,
            4,
            &[
                2.0, 0.0, 0.0, 0.0, //
                0.5, 1.5, 0.0, 0.0, //
                0.0, 0.0, 3.0, 0.0, //
                1.0, 2.0, 2.0, 4.0,
            ],
        );
        let known = RobotPosterior::with_balls(&ids, &robot.geometry, &balls, &root).unwrap();
        assert_eq!((known.ids(), known.all_ids()), (&ids[..1], &ids[..]));
        assert_eq!(known.ball(BallId::at(1)), Some(balls[1]));
        assert_eq!(known.ball(BallId::FIRST), None);
        // sd = norm of the row of the root.
        assert!((known.sd(z).unwrap() - 5.0).abs() < 1e-14);
        // cov(y, z) = 6, in any order of the rows.
        let pair = known.root_of(&[z, y]);
        let covariance = &pair * pair.transpose();
        assert!((covariance[(0, 1)] - 6.0).abs() < 1e-13 && (covariance[(1, 1)] - 9.0).abs() < 1e-13);
        assert_eq!(pair[(0, 1)], 0.0);
        assert!(known.is_sound());
        // Singular covariances, and balls that the model does not have, are refused.
        assert!(RobotPosterior::with_balls(&ids, &robot.geometry, &balls, &DMatrix::zeros(4, 4)).is_none());
        assert!(RobotPosterior::with_balls(&ids, &robot.geometry, &balls[..1], &root).is_none());
        assert!(known.keeping(|_| false).is_none());
    }

    #[test]
    fn unsound_posteriors_are_recognised() {
        let robot = Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap();
        let ids = [ParamId::A(Joint::J2), ParamId::D(Joint::J4)];
        let sound = RobotPosterior::new(&ids, &robot.geometry, &DMatrix::identity(2, 2)).unwrap();
        assert!(sound.is_sound());
        let twice = RobotPosterior { ids: vec![ids[0]; 2], ..sound.clone() };
        let short = RobotPosterior { values: vec![1.0], ..sound.clone() };
        let wide = RobotPosterior { root: DMatrix::identity(3, 3), ..sound.clone() };
        let infinite = RobotPosterior { values: vec![1.0, f64::INFINITY], ..sound.clone() };
        let gear = RobotPosterior { ids: vec![ids[0], ParamId::GearCos(Joint::J1)], ..sound.clone() };
        let ball = ParamId::Ball(BallId::FIRST, Coordinate::X);
        let ball_first = RobotPosterior { ids: vec![ball, ids[0]], ..sound };
        for unsound in [twice, short, wide, infinite, gear, ball_first] {
            assert!(!unsound.is_sound(), "{unsound:?}");
        }
    }
}
