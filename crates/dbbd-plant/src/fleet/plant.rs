//! The means of the types and the bars, after elimination of the robots by Schur complements.
//!
//! A robot x of a type with the mean m and the covariance S is normal about m. The likelihood of its runs is
//! exp(-x'Ax/2 - x'Bk - k'Ck/2 + x'a + k'c) with the bars k at its knots. With D = (A + S^-1)^-1, integration over x gives the
//! information [S^-1 - S^-1 D S^-1, S^-1 D B; B'D S^-1, C - B'D B] on (m, k). Given these, the robot is normal about
//! D (a + S^-1 m - B k) with the covariance D.

use nalgebra::{DMatrix, DVector};

use super::bars::{Column, histories};
use super::kind::Moments;
use super::{Assumptions, Fleet, FleetRobot, Folded, ITERATIONS, Kind, Knot, SETTLED, inverse};
use dbbd_model::math::distributions::chi_square_exceeded;

/// Significance level of a jump.
const JUMP: f64 = 1e-4;

/// The state of the estimation.
pub(super) struct Plant {
    robots: Vec<Folded>,
    kinds: Vec<Kind>,
    bars: Vec<String>,
    assumed: Assumptions,
    knots: Vec<Knot>,
    columns: Vec<Column>,
    /// Index of the mean of each type among the unknowns, then the index of the first column of the bars.
    begins: Vec<usize>,
}

/// Information on the means, then on the bars at the knots.
struct Information {
    matrix: DMatrix<f64>,
    rhs: DVector<f64>,
}

/// The posterior of the means, then of the bars' columns.
struct Solved {
    values: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Plant {
    pub(super) fn new(
        robots: Vec<Folded>,
        kinds: Vec<Kind>,
        bars: Vec<String>,
        assumed: Assumptions,
    ) -> Self {
        let mut knots: Vec<Knot> = robots.iter().flat_map(|robot| robot.knots.iter().copied()).collect();
        knots.sort_unstable();
        knots.dedup();
        let columns = (0..bars.len()).flat_map(|bar| [Column::Offset(bar), Column::Drift(bar)]).collect();
        let mut begins = vec![0];
        for kind in &kinds {
            begins.push(begins[begins.len() - 1] + kind.count());
        }
        Self { robots, kinds, bars, assumed, knots, columns, begins }
    }

    fn means(&self) -> usize {
        self.begins[self.kinds.len()]
    }

    /// Iterates until the covariances of the types converge.
    pub(super) fn settle(&mut self) -> Option<()> {
        for _ in 0..ITERATIONS {
            let solved = self.solve(&self.information()?)?;
            let found = self.moments(&solved)?;
            let mut most = 0.0f64;
            for (at, kind) in self.kinds.iter_mut().enumerate() {
                let own = self.robots.iter().zip(&found).filter(|(robot, _)| robot.kind == at);
                most = most.max(kind.maximise(&own.map(|(_, moments)| moments).collect::<Vec<_>>()));
            }
            if most < SETTLED {
                break;
            }
        }
        Some(())
    }

    /// The indices of a robot's unknowns in the information: the mean of its type, its knots.
    fn places(&self, robot: &Folded) -> Vec<usize> {
        let knots = robot.knots.iter().filter_map(|knot| self.knots.binary_search(knot).ok());
        let knots = knots.map(|at| self.means() + at);
        (self.begins[robot.kind]..self.begins[robot.kind + 1]).chain(knots).collect()
    }

    fn information(&self) -> Option<Information> {
        let size = self.means() + self.knots.len();
        let (mut matrix, mut rhs) = (DMatrix::zeros(size, size), DVector::zeros(size));
        for robot in &self.robots {
            let kind = &self.kinds[robot.kind];
            let (count, others) = (kind.count(), robot.knots.len());
            let given = Given::new(robot, kind)?;
            let coupled = given.coupling.tr_mul(&given.covariance);
            let mut reduced = -(&coupled * &given.coupling);
            let mut own = reduced.view_mut((0, 0), (count, count));
            own += &given.prior;
            let mut bars = reduced.view_mut((count, count), (others, others));
            bars += robot.information.view((count, count), (others, others));
            let mut right = coupled * robot.rhs.rows(0, count);
            let mut of_bars = right.rows_mut(count, others);
            of_bars += robot.rhs.rows(count, others);
            let places = self.places(robot);
            for (i, &row) in places.iter().enumerate() {
                rhs[row] += right[i];
                places.iter().enumerate().for_each(|(j, &column)| matrix[(row, column)] += reduced[(i, j)]);
            }
        }
        Some(Information { matrix, rhs })
    }

    /// Means and columns, from the information and their priors.
    fn solve(&self, information: &Information) -> Option<Solved> {
        let (means, knots, columns) = (self.means(), self.knots.len(), self.columns.len());
        let design = Column::design(&self.columns, &self.knots);
        let of = |at, shape| information.matrix.view(at, shape);
        let cross = of((0, means), (means, knots)) * &design;
        let mut normal = DMatrix::identity(means + columns, means + columns);
        let mut own = normal.view_mut((0, 0), (means, means));
        own += of((0, 0), (means, means));
        normal.view_mut((0, means), (means, columns)).copy_from(&cross);
        normal.view_mut((means, 0), (columns, means)).copy_from(&cross.transpose());
        let bars = design.tr_mul(&(of((means, means), (knots, knots)) * &design));
        normal.view_mut((means, means), (columns, columns)).copy_from(&bars);
        for (at, column) in self.columns.iter().enumerate() {
            normal[(means + at, means + at)] += column.prior_sd(&self.assumed).powi(-2);
        }
        let covariance = inverse(&normal)?;
        let mut rhs = information.rhs.rows(0, means).into_owned().resize_vertically(means + columns, 0.0);
        rhs.rows_mut(means, columns).copy_from(&design.tr_mul(&information.rhs.rows(means, knots)));
        Some(Solved { values: &covariance * rhs, covariance })
    }

    fn moments(&self, solved: &Solved) -> Option<Vec<Moments>> {
        let design = Column::design(&self.columns, &self.knots);
        self.robots.iter().map(|robot| self.moments_of(robot, solved, &design)).collect()
    }

    fn moments_of(&self, robot: &Folded, solved: &Solved, design: &DMatrix<f64>) -> Option<Moments> {
        let kind = &self.kinds[robot.kind];
        let count = kind.count();
        let given = Given::new(robot, kind)?;
        let knots: Vec<usize> =
            self.places(robot).split_off(count).iter().map(|at| at - self.means()).collect();
        // The derivative of the robot's mean by the unknowns of the plant.
        let through = &given.covariance * &given.coupling;
        let mut by_unknown = DMatrix::zeros(count, solved.values.len());
        by_unknown.columns_mut(self.begins[robot.kind], count).copy_from(&through.columns(0, count));
        by_unknown
            .columns_mut(self.means(), self.columns.len())
            .copy_from(&(through.columns(count, knots.len()) * design.select_rows(&knots)));
        let mean = &given.covariance * robot.rhs.rows(0, count) + &by_unknown * &solved.values;
        let spread = |by: &DMatrix<f64>| &given.covariance + by * &solved.covariance * by.transpose();
        let covariance = spread(&by_unknown);
        let begin = self.begins[robot.kind];
        (0..count).for_each(|at| by_unknown[(at, begin + at)] -= 1.0);
        let off = &mean - solved.values.rows(begin, count);
        let about_mean = spread(&by_unknown) + &off * off.transpose();
        Some(Moments { mean, covariance, about_mean })
    }

    /// Adds the significant jumps. Returns whether there was one.
    pub(super) fn finds_jumps(&mut self) -> Option<bool> {
        let (information, means) = (self.information()?, self.means());
        let candidates = Column::jumps(&self.knots);
        let limit = chi_square_exceeded(JUMP / candidates.len().max(1) as f64, 1.0);
        let tested = Column::design(&candidates, &self.knots);
        let weighted = information.matrix.columns(means, self.knots.len()) * &tested;
        let before = self.columns.len();
        loop {
            let solved = self.solve(&information)?;
            let design = Column::design(&self.columns, &self.knots);
            let mut model =
                solved.values.rows(0, means).into_owned().resize_vertically(weighted.nrows(), 0.0);
            let of_bars = &design * solved.values.rows(means, self.columns.len());
            model.rows_mut(means, self.knots.len()).copy_from(&of_bars);
            let left = information.rhs.rows(means, self.knots.len()).tr_mul(&tested).transpose()
                - weighted.tr_mul(&model);
            let of_knots = weighted.rows(means, self.knots.len());
            let mut cross = weighted.rows(0, means).into_owned().resize_vertically(solved.values.len(), 0.0);
            cross.rows_mut(means, self.columns.len()).copy_from(&design.tr_mul(&of_knots));
            let explained = (&solved.covariance * &cross).component_mul(&cross).row_sum();
            let score = |at: usize| {
                let variance = tested.column(at).dot(&of_knots.column(at)) - explained[at];
                if variance > 0.0 { left[at].powi(2) / variance } else { 0.0 }
            };
            let best = (0..candidates.len()).map(|at| (score(at), at)).max_by(|a, b| a.0.total_cmp(&b.0));
            match best {
                Some((score, at)) if score > limit && !self.columns.contains(&candidates[at]) => {
                    self.columns.push(candidates[at]);
                }
                _ => return Some(self.columns.len() > before),
            }
        }
    }

    pub(super) fn fleet(self) -> Option<Fleet> {
        let solved = self.solve(&self.information()?)?;
        let (means, columns) = (self.means(), self.columns.len());
        let of_bars = solved.covariance.view((means, means), (columns, columns)).into_owned();
        let values = solved.values.rows(means, columns).into_owned();
        let bars = histories(&self.bars, &self.knots, &self.columns, &values, &of_bars);
        let of_type = |(at, kind): (usize, &Kind)| {
            let (begin, count) = (self.begins[at], kind.count());
            let robots = self.robots.iter().filter(|robot| robot.kind == at).count();
            let covariance = solved.covariance.view((begin, begin), (count, count)).into_owned();
            kind.of_type(solved.values.rows(begin, count).into_owned(), &covariance, robots)
        };
        let types = self.kinds.iter().enumerate().map(of_type).collect();
        let moments = self.moments(&solved)?;
        let kinds = &self.kinds;
        let robot = |(robot, moments): (Folded, Moments)| {
            let kind = &kinds[robot.kind];
            let scale = DMatrix::from_diagonal(&kind.scale);
            FleetRobot {
                robot: robot.robot,
                kind: kind.name.clone(),
                corrections: moments.mean.component_mul(&kind.scale),
                covariance: &scale * moments.covariance * &scale,
                crashes: robot.crashes,
            }
        };
        let robots = self.robots.into_iter().zip(moments).map(robot).collect();
        Some(Fleet { bars, robots, types, unusable: 0 })
    }
}

/// A robot given the mean of its type and the bars is normal about `covariance * (a + coupling * [m; k])`.
struct Given {
    covariance: DMatrix<f64>,
    /// S^-1.
    prior: DMatrix<f64>,
    /// [S^-1, -B].
    coupling: DMatrix<f64>,
}

impl Given {
    fn new(robot: &Folded, kind: &Kind) -> Option<Self> {
        let (count, others) = (kind.count(), robot.knots.len());
        let prior = inverse(&kind.covariance)?;
        let covariance = inverse(&(robot.information.view((0, 0), (count, count)) + &prior))?;
        let mut coupling = DMatrix::zeros(count, count + others);
        coupling.columns_mut(0, count).copy_from(&prior);
        coupling.columns_mut(count, others).copy_from(&-robot.information.view((0, count), (count, others)));
        Some(Self { covariance, prior, coupling })
    }
}
