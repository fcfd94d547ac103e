//! What the runs of a plant say together: each robot at its first run, each bar with its drift and its jumps, each type of
//! robot with the mean and the covariance of its robots.
//!
//! A run enters as what its lengths alone say, in information form: its posterior without the prior that it was
//! identified with. The runs of a robot are folded, the newest first, into one Gaussian of the robot at its first run and
//! of the bars' offsets at the times of its runs (Kalman filter; a robot drifts as a random walk, and a run that
//! contradicts the later ones is a crash). Then the robots leave by their Schur complement and the bars remain: a small
//! system. The types follow by empirical Bayes (EM: Dempster, Laird and Rubin 1977), with the maker's tolerance as the
//! prior of their covariance. Memory grows with robots and bars, not with runs.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use crate::catalogue::ArchiveFinding;
use crate::math::distributions::chi_square_exceeded;
use crate::robot::{ParamId, Robot, RobotPosterior};

/// Offsets of a bar within so many days are one.
const EPOCH_DAYS: f64 = 10.0;
/// Before any run, a bar's offset at a time may be anything, mm; this much is taken away again.
const OPEN_MM: f64 = 10.0;
/// The same for a robot, in standard deviations of its prior.
const OPEN: f64 = 30.0;
/// A robot of a type before any robot of the type: so many robots as the maker's tolerance describes them.
const WEIGHT: f64 = 4.0;
/// A run contradicts others, and a bar jumped, when chance does it with this probability.
const CRASH: f64 = 1e-6;
const JUMP: f64 = 1e-4;
/// Standard deviation of a bar's drift before any run, mm a year.
const BAR_DRIFT_MM: f64 = 0.05;
/// And of a jump, mm.
const JUMP_MM: f64 = 1.0;
/// Directions whose variance the lengths change by less than this share say nothing.
const LEAST_SHARE: f64 = 1e-9;
const YEAR_DAYS: f64 = 365.25;
const ITERATIONS: usize = 30;

/// What an identification found of a robot and its bar, and what it knew beforehand.
#[derive(Clone, Debug)]
pub struct RunPosterior {
    pub robot: String,
    /// The robot's type.
    pub kind: String,
    pub bar: String,
    /// Days from any fixed one.
    pub day: f64,
    pub ids: Vec<ParamId>,
    /// Corrections of the nominal values, mm or rad.
    pub corrections: DVector<f64>,
    pub covariance: DMatrix<f64>,
    /// Standard deviations of the prior about the nominal values; `None` of what was free.
    pub prior: Vec<Option<f64>>,
}

/// What is assumed of a plant.
#[derive(Clone, Copy, Debug)]
pub struct Assumptions {
    /// Standard deviation of a robot's drift in a year, in those of its prior.
    pub drift: f64,
    /// Of a bar's length by its certificate, mm.
    pub bar_u_mm: f64,
}

impl Default for Assumptions {
    fn default() -> Self {
        Self { drift: 0.1, bar_u_mm: 0.05 }
    }
}

/// A number with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Estimate {
    pub value: f64,
    pub sd: f64,
}

impl Estimate {
    /// Whether it is within the interval of 95 %.
    pub fn covers(&self, truth: f64) -> bool {
        (self.value - truth).abs() <= 1.959_964 * self.sd
    }
}

/// A bar: its offset is `offset + drift * years since the first run + sum of jumps before`.
#[derive(Clone, Debug, serde::Serialize)]
pub struct BarHistory {
    pub bar: String,
    /// At the plant's first run, mm.
    pub offset_mm: Estimate,
    pub drift_mm_a_year: Estimate,
    pub jumps: Vec<Jump>,
    /// At the plant's last run, mm.
    pub offset_now_mm: Estimate,
}

/// A bar's sudden change, such as that of a bar that was dropped.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Jump {
    /// It came after this day and before the next one in which the bar was used.
    pub after_day: f64,
    pub before_day: f64,
    pub change_mm: Estimate,
}

/// A robot at its first run.
#[derive(Clone, Debug)]
pub struct FleetRobot {
    pub robot: String,
    pub kind: String,
    pub corrections: DVector<f64>,
    pub covariance: DMatrix<f64>,
    /// Days of runs that the one before contradicts.
    pub crashes: Vec<f64>,
}

/// The robots of a type: what a new one is before any length.
#[derive(Clone, Debug)]
pub struct FleetType {
    pub kind: String,
    pub ids: Vec<ParamId>,
    pub mean: DVector<f64>,
    /// Of a new robot about `mean`, with the uncertainty of the mean.
    pub covariance: DMatrix<f64>,
    pub robots: usize,
}

impl FleetType {
    /// A new robot of the type, for `dbbd identify --robot`: the likeliest values, and what is not known of them as its
    /// posterior. `None` where a parameter is none of `nominal`'s.
    pub fn robot(&self, nominal: &Robot) -> Option<Robot> {
        let mut robot = nominal.clone();
        for (id, correction) in self.ids.iter().zip(self.mean.iter()) {
            *robot.geometry.value_mut(*id)? += correction;
        }
        let root = self.covariance.clone().cholesky()?.l();
        robot.posterior = Some(RobotPosterior::new(&self.ids, &robot.geometry, &root)?);
        robot.serial = None;
        Some(robot)
    }
}

/// The plant.
#[derive(Clone, Debug, Default)]
pub struct Fleet {
    pub bars: Vec<BarHistory>,
    pub robots: Vec<FleetRobot>,
    pub types: Vec<FleetType>,
    /// Runs whose posterior has no inverse.
    pub unusable: usize,
}

impl Fleet {
    /// Bars that jumped, and robots that changed suddenly.
    pub fn findings(&self) -> Vec<ArchiveFinding> {
        let jumps = self.bars.iter().flat_map(|bar| bar.jumps.iter().map(move |jump| (bar, jump.change_mm)));
        let jumped = jumps.map(|(bar, change_mm)| {
            let [um, sd_um] = [change_mm.value, change_mm.sd].map(|mm| 1e3 * mm);
            ArchiveFinding::BarJumped { bar: bar.bar.clone(), um, sd_um }
        });
        let crashed = self.robots.iter().filter(|robot| !robot.crashes.is_empty());
        let changed = crashed.map(|robot| ArchiveFinding::RobotChanged {
            robot: robot.robot.clone(),
            times: robot.crashes.len(),
        });
        jumped.chain(changed).collect()
    }
}

/// A bar within a span of time.
type Knot = (usize, i64);

/// The runs of a robot, folded: information on the robot at its first run (scaled by its prior) and on the bars.
struct Folded {
    robot: String,
    kind: usize,
    knots: Vec<Knot>,
    information: DMatrix<f64>,
    rhs: DVector<f64>,
    crashes: Vec<f64>,
}

/// The robots of a type while they are estimated, in units of `scale`.
struct Kind {
    name: String,
    ids: Vec<ParamId>,
    scale: DVector<f64>,
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

/// A column of the bars' system.
#[derive(Clone, Copy, PartialEq)]
enum Column {
    Offset(usize),
    Drift(usize),
    /// Of a bar, from an epoch on.
    Jump(usize, i64),
}

impl Column {
    fn value(self, (bar, epoch): Knot, first: i64) -> f64 {
        match self {
            Self::Offset(own) => f64::from(u8::from(own == bar)),
            Self::Drift(own) if own == bar => (epoch - first) as f64 * EPOCH_DAYS / YEAR_DAYS,
            Self::Drift(_) => 0.0,
            Self::Jump(own, from) => f64::from(u8::from(own == bar && epoch >= from)),
        }
    }

    fn prior_sd(self, assumed: &Assumptions) -> f64 {
        match self {
            Self::Offset(_) => assumed.bar_u_mm,
            Self::Drift(_) => BAR_DRIFT_MM,
            Self::Jump(..) => JUMP_MM,
        }
    }
}

/// The inverse of a symmetric positive definite matrix, `None` where it is not.
fn inverse(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    Some(matrix.clone().cholesky()?.inverse())
}

/// What the lengths of a run alone say of the parameters of its kind (scaled) and of the bar: the last column.
fn information(run: &RunPosterior, kind: &Kind) -> Option<(DMatrix<f64>, DVector<f64>)> {
    let count = kind.ids.len();
    let bar = run.ids.iter().position(|id| matches!(id, ParamId::BarOffset(_)));
    let places: Vec<Option<usize>> = run
        .ids
        .iter()
        .map(|id| {
            kind.ids
                .iter()
                .position(|own| own == id)
                .or((matches!(id, ParamId::BarOffset(_))).then_some(count))
        })
        .collect();
    let scale = |at: usize| places[at].map_or(1.0, |to| if to == count { 1.0 } else { kind.scale[to] });
    let kept: Vec<usize> = (0..run.ids.len()).filter(|&at| places[at].is_some()).collect();
    let n = kept.len();
    let covariance =
        DMatrix::from_fn(n, n, |i, j| run.covariance[(kept[i], kept[j])] / (scale(kept[i]) * scale(kept[j])));
    let all = inverse(&covariance)?;
    let mean = DVector::from_fn(n, |i, _| run.corrections[kept[i]] / scale(kept[i]));
    // In units of the prior its information is one in each direction: less than that is rounding.
    let prior =
        DVector::from_fn(n, |i, _| run.prior[kept[i]].map_or(0.0, |sd| (scale(kept[i]) / sd).powi(2)));
    let own = DVector::from_fn(n, |i, _| if prior[i] > 0.0 { prior[i].sqrt() } else { all[(i, i)].sqrt() });
    let whitened = DMatrix::from_fn(n, n, |i, j| {
        (all[(i, j)] - if i == j { prior[i] } else { 0.0 }) / (own[i] * own[j])
    });
    let eigen = whitened.symmetric_eigen();
    let values = eigen.eigenvalues.map(|value| if value > LEAST_SHARE { value } else { 0.0 });
    let data = &eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose();
    let data = DMatrix::from_fn(n, n, |i, j| data[(i, j)] * own[i] * own[j]);
    let rhs = &all * mean;
    let (mut full, mut right) = (DMatrix::zeros(count + 1, count + 1), DVector::zeros(count + 1));
    for i in 0..n {
        let Some(row) = places[kept[i]] else { continue };
        right[row] = rhs[i];
        for j in 0..n {
            if let Some(column) = places[kept[j]] {
                full[(row, column)] = data[(i, j)];
            }
        }
    }
    bar.map(|_| (full, right))
}

/// The state of a robot, the newest run first: itself and the knots that its runs touched.
struct Filter {
    knots: Vec<Knot>,
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Filter {
    fn new(count: usize) -> Self {
        Self {
            knots: Vec::new(),
            mean: DVector::zeros(count),
            covariance: DMatrix::identity(count, count) * (OPEN * OPEN),
        }
    }

    /// The place of a knot, which begins as unknown.
    fn place(&mut self, knot: Knot, count: usize) -> usize {
        if let Some(at) = self.knots.iter().position(|known| *known == knot) {
            return count + at;
        }
        self.knots.push(knot);
        let size = self.mean.len();
        self.mean = self.mean.clone().insert_row(size, 0.0);
        self.covariance = self.covariance.clone().insert_row(size, 0.0).insert_column(size, 0.0);
        self.covariance[(size, size)] = OPEN_MM * OPEN_MM;
        size
    }

    /// The robot may be another by this variance, in every direction.
    fn widen(&mut self, count: usize, variance: f64) {
        (0..count).for_each(|at| self.covariance[(at, at)] += variance);
    }

    /// How far a run is from what is known: chi square and its degrees of freedom.
    fn contradiction(&self, places: &[usize], data: &DMatrix<f64>, rhs: &DVector<f64>) -> Option<(f64, f64)> {
        let own = self.covariance.select_rows(places).select_columns(places);
        let root = own.cholesky()?.l();
        let expected = DVector::from_fn(places.len(), |i, _| self.mean[places[i]]);
        let eigen = (root.transpose() * data * &root).symmetric_eigen();
        let right = eigen.eigenvectors.tr_mul(&(root.transpose() * (rhs - data * expected)));
        let seen = eigen.eigenvalues.iter().zip(right.iter()).filter(|(value, _)| **value > 1e-3);
        let (square, freedom) = seen.fold((0.0, 0.0), |(square, freedom), (value, right)| {
            (square + right * right / (value * (1.0 + value)), freedom + 1.0)
        });
        Some((square, freedom))
    }

    /// Adds information on the parameters at `places`.
    fn update(&mut self, places: &[usize], data: &DMatrix<f64>, rhs: &DVector<f64>) -> Option<()> {
        let before = inverse(&self.covariance)?;
        let (mut after, mut right) = (before.clone(), &before * &self.mean);
        for (i, &row) in places.iter().enumerate() {
            right[row] += rhs[i];
            places.iter().enumerate().for_each(|(j, &column)| after[(row, column)] += data[(i, j)]);
        }
        self.covariance = inverse(&after)?;
        self.mean = &self.covariance * right;
        Some(())
    }
}

/// Folds the runs of a robot; they are in the order of time. The number of runs that cannot be used.
fn fold(
    runs: &[&RunPosterior],
    kinds: &[Kind],
    bars: &[String],
    assumed: &Assumptions,
) -> Option<(Folded, usize)> {
    let first = runs.first()?;
    let at = kinds.iter().position(|kind| kind.name == first.kind)?;
    let (kind, count) = (&kinds[at], kinds[at].ids.len());
    let (mut filter, mut crashes, mut unusable, mut later) = (Filter::new(count), Vec::new(), 0, None);
    for run in runs.iter().rev() {
        let Some((data, rhs)) = information(run, kind) else {
            unusable += 1;
            continue;
        };
        if let Some(later) = later {
            let years: f64 = (later - run.day) / YEAR_DAYS;
            filter.widen(count, assumed.drift * assumed.drift * years.max(0.0));
        }
        let bar = bars.iter().position(|bar| *bar == run.bar)?;
        let knot = filter.place((bar, (run.day / EPOCH_DAYS).floor() as i64), count);
        let places: Vec<usize> = (0..count).chain([knot]).collect();
        if let Some(later) = later
            && let Some((square, freedom)) = filter.contradiction(&places, &data, &rhs)
            && square > chi_square_exceeded(CRASH, freedom)
        {
            crashes.push(later);
            filter.widen(count, OPEN * OPEN);
        }
        later = Some(run.day);
        filter.update(&places, &data, &rhs)?;
    }
    crashes.reverse();
    // What was assumed at the begin is taken away again.
    let mut information = inverse(&filter.covariance)?;
    let rhs = &information * &filter.mean;
    for place in 0..information.nrows() {
        let open = if place < count { OPEN } else { OPEN_MM };
        information[(place, place)] -= 1.0 / (open * open);
    }
    let robot = first.robot.clone();
    Some((Folded { robot, kind: at, knots: filter.knots, information, rhs, crashes }, unusable))
}

/// The bars once the robots have left: the information on their knots.
struct Bars {
    knots: Vec<Knot>,
    information: DMatrix<f64>,
    rhs: DVector<f64>,
}

impl Bars {
    /// By the Schur complement of each robot.
    fn of(robots: &[Folded], kinds: &[Kind], knots: &[Knot]) -> Option<Self> {
        let size = knots.len();
        let (mut information, mut rhs) = (DMatrix::zeros(size, size), DVector::zeros(size));
        for robot in robots {
            let kind = &kinds[robot.kind];
            let count = kind.ids.len();
            let prior = inverse(&kind.covariance)?;
            let own = inverse(&(robot.information.view((0, 0), (count, count)) + &prior))?;
            let right = robot.rhs.rows(0, count) + prior * &kind.mean;
            let others = robot.knots.len();
            let cross = robot.information.view((count, 0), (others, count));
            let reduced =
                robot.information.view((count, count), (others, others)) - cross * &own * cross.transpose();
            let right = robot.rhs.rows(count, others) - cross * (own * right);
            let places: Vec<usize> =
                robot.knots.iter().filter_map(|knot| knots.binary_search(knot).ok()).collect();
            for (i, &row) in places.iter().enumerate() {
                rhs[row] += right[i];
                places
                    .iter()
                    .enumerate()
                    .for_each(|(j, &column)| information[(row, column)] += reduced[(i, j)]);
            }
        }
        Some(Self { knots: knots.to_vec(), information, rhs })
    }

    fn design(&self, columns: &[Column]) -> DMatrix<f64> {
        let first = self.knots.iter().map(|(_, epoch)| *epoch).min().unwrap_or(0);
        DMatrix::from_fn(self.knots.len(), columns.len(), |at, column| {
            columns[column].value(self.knots[at], first)
        })
    }

    /// The columns' values and covariance.
    fn solve(&self, columns: &[Column], assumed: &Assumptions) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let design = self.design(columns);
        let mut normal = design.tr_mul(&(&self.information * &design));
        columns
            .iter()
            .enumerate()
            .for_each(|(at, column)| normal[(at, at)] += column.prior_sd(assumed).powi(-2));
        let covariance = inverse(&normal)?;
        Some((&covariance * design.tr_mul(&self.rhs), covariance))
    }

    /// Adds jumps as long as one is far beyond chance.
    fn with_jumps(&self, mut columns: Vec<Column>, assumed: &Assumptions) -> Option<Vec<Column>> {
        let first_of = |bar: usize| self.knots.iter().filter(|knot| knot.0 == bar).map(|knot| knot.1).min();
        let candidates: Vec<Column> = self
            .knots
            .iter()
            .filter(|(bar, epoch)| first_of(*bar) != Some(*epoch))
            .map(|(bar, epoch)| Column::Jump(*bar, *epoch))
            .collect();
        let limit = chi_square_exceeded(JUMP / candidates.len().max(1) as f64, 1.0);
        loop {
            let (values, covariance) = self.solve(&columns, assumed)?;
            let design = self.design(&columns);
            let residual = &self.rhs - &self.information * (&design * values);
            let tested = self.design(&candidates);
            let weighted = &self.information * &tested;
            let cross = design.tr_mul(&weighted);
            let score = |at: usize| {
                let column = tested.column(at);
                let variance = column.dot(&weighted.column(at))
                    - cross.column(at).dot(&(&covariance * cross.column(at)));
                if variance > 0.0 { column.dot(&residual).powi(2) / variance } else { 0.0 }
            };
            let best = (0..candidates.len()).map(|at| (score(at), at)).max_by(|a, b| a.0.total_cmp(&b.0));
            match best {
                Some((score, at)) if score > limit && !columns.contains(&candidates[at]) => {
                    columns.push(candidates[at])
                }
                _ => return Some(columns),
            }
        }
    }
}

/// The robots of each type by what they were nominally and by the maker's tolerance.
fn kinds(runs: &[RunPosterior]) -> Vec<Kind> {
    let mut found: BTreeMap<&str, BTreeMap<ParamId, f64>> = BTreeMap::new();
    for run in runs {
        let own = found.entry(&run.kind).or_default();
        for (id, prior) in run.ids.iter().zip(&run.prior) {
            if let (true, Some(sd)) = (id.is_geometric(), prior) {
                own.insert(*id, *sd);
            }
        }
    }
    let kind = |(name, own): (&str, BTreeMap<ParamId, f64>)| Kind {
        name: name.into(),
        mean: DVector::zeros(own.len()),
        covariance: DMatrix::identity(own.len(), own.len()),
        scale: DVector::from_iterator(own.len(), own.values().copied()),
        ids: own.into_keys().collect(),
    };
    found.into_iter().map(kind).collect()
}

/// A robot's place and covariance once the bars are known.
fn robot_given(
    robot: &Folded,
    kind: &Kind,
    bars: &DVector<f64>,
    of_bars: &DMatrix<f64>,
) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let (count, others) = (kind.ids.len(), robot.knots.len());
    let prior = inverse(&kind.covariance)?;
    let own = inverse(&(robot.information.view((0, 0), (count, count)) + &prior))?;
    let cross = robot.information.view((0, count), (count, others));
    let right = robot.rhs.rows(0, count) + prior * &kind.mean - cross * bars;
    let through = &own * cross;
    let covariance = &own + &through * of_bars * through.transpose();
    Some((own * right, covariance))
}

/// The plant from its runs, in any order.
///
/// `None` where a system has no solution: a number is not finite.
pub fn fleet(runs: &[RunPosterior], assumed: &Assumptions) -> Option<Fleet> {
    let mut by_robot: BTreeMap<&str, Vec<&RunPosterior>> = BTreeMap::new();
    runs.iter().for_each(|run| by_robot.entry(&run.robot).or_default().push(run));
    let mut bars: Vec<String> = runs.iter().map(|run| run.bar.clone()).collect();
    bars.sort_unstable();
    bars.dedup();
    let mut kinds = kinds(runs);
    let (mut robots, mut unusable) = (Vec::new(), 0);
    for own in by_robot.values_mut() {
        own.sort_by(|a, b| a.day.total_cmp(&b.day));
        let (folded, without) = fold(own, &kinds, &bars, assumed)?;
        unusable += without;
        robots.push(folded);
    }
    let mut knots: Vec<Knot> = robots.iter().flat_map(|robot| robot.knots.iter().copied()).collect();
    knots.sort_unstable();
    knots.dedup();
    let plain = (0..bars.len()).flat_map(|bar| [Column::Offset(bar), Column::Drift(bar)]).collect::<Vec<_>>();
    let mut columns = plain.clone();
    let mut given = Vec::new();
    let mut solved = None;
    for iteration in 0..ITERATIONS {
        let system = Bars::of(&robots, &kinds, &knots)?;
        // The jumps are looked for where the types are settled.
        if iteration % 10 == 9 {
            columns = system.with_jumps(plain.clone(), assumed)?;
        }
        let (values, covariance) = system.solve(&columns, assumed)?;
        let design = system.design(&columns);
        given = Vec::new();
        for robot in &robots {
            let places: Vec<usize> =
                robot.knots.iter().filter_map(|knot| knots.binary_search(knot).ok()).collect();
            let rows = design.select_rows(&places);
            let of_bars = &rows * &covariance * rows.transpose();
            given.push(robot_given(robot, &kinds[robot.kind], &(&rows * &values), &of_bars)?);
        }
        solved = Some((values, covariance));
        if iteration + 1 < ITERATIONS {
            maximise(&mut kinds, &robots, &given);
        }
    }
    let (values, covariance) = solved?;
    Some(Fleet {
        bars: histories(&bars, &knots, &columns, &values, &covariance),
        types: kinds
            .iter()
            .enumerate()
            .map(|(at, kind)| of_type(kind, robots.iter().filter(|robot| robot.kind == at).count()))
            .collect(),
        robots: robots
            .into_iter()
            .zip(given)
            .map(|(robot, (mean, spread))| {
                let kind = &kinds[robot.kind];
                let scale = DMatrix::from_diagonal(&kind.scale);
                FleetRobot {
                    robot: robot.robot,
                    kind: kind.name.clone(),
                    corrections: mean.component_mul(&kind.scale),
                    covariance: &scale * spread * &scale,
                    crashes: robot.crashes,
                }
            })
            .collect(),
        unusable,
    })
}

/// Mean and covariance of each type from its robots.
fn maximise(kinds: &mut [Kind], robots: &[Folded], given: &[(DVector<f64>, DMatrix<f64>)]) {
    for (at, kind) in kinds.iter_mut().enumerate() {
        let own: Vec<_> =
            robots.iter().zip(given).filter(|(robot, _)| robot.kind == at).map(|(_, given)| given).collect();
        let (count, size) = (own.len() as f64, kind.ids.len());
        // The mean is nominal with the weight of one robot.
        let mean = own.iter().fold(DVector::zeros(size), |sum, (mean, _)| sum + mean) / (count + 1.0);
        let spread = own.iter().fold(DMatrix::identity(size, size) * WEIGHT, |sum, (place, covariance)| {
            let off = place - &mean;
            sum + covariance + &off * off.transpose()
        });
        (kind.mean, kind.covariance) = (mean, spread / (count + WEIGHT));
    }
}

fn of_type(kind: &Kind, robots: usize) -> FleetType {
    let scale = DMatrix::from_diagonal(&kind.scale);
    FleetType {
        kind: kind.name.clone(),
        ids: kind.ids.clone(),
        mean: kind.mean.component_mul(&kind.scale),
        covariance: &scale * &kind.covariance * &scale * (1.0 + 1.0 / (robots as f64 + 1.0)),
        robots,
    }
}

fn histories(
    bars: &[String],
    knots: &[Knot],
    columns: &[Column],
    values: &DVector<f64>,
    covariance: &DMatrix<f64>,
) -> Vec<BarHistory> {
    let epochs = knots.iter().map(|(_, epoch)| *epoch);
    let (first, last) = (epochs.clone().min().unwrap_or(0), epochs.max().unwrap_or(0));
    let along = |row: DVector<f64>| Estimate {
        value: row.dot(values),
        sd: (row.dot(&(covariance * &row))).max(0.0).sqrt(),
    };
    let unit = |wanted: Column| {
        along(DVector::from_fn(columns.len(), |at, _| f64::from(u8::from(columns[at] == wanted))))
    };
    let history = |(bar, name): (usize, &String)| BarHistory {
        bar: name.clone(),
        offset_mm: unit(Column::Offset(bar)),
        drift_mm_a_year: unit(Column::Drift(bar)),
        jumps: columns
            .iter()
            .filter_map(|column| match *column {
                Column::Jump(own, from) if own == bar => {
                    let before =
                        knots.iter().filter(|knot| knot.0 == bar && knot.1 < from).map(|knot| knot.1).max();
                    let after_day = before.map_or(from, |epoch| epoch) as f64 * EPOCH_DAYS;
                    Some(Jump {
                        after_day,
                        before_day: (from + 1) as f64 * EPOCH_DAYS,
                        change_mm: unit(*column),
                    })
                }
                _ => None,
            })
            .collect(),
        offset_now_mm: along(DVector::from_fn(columns.len(), |at, _| columns[at].value((bar, last), first))),
    };
    bars.iter().enumerate().map(history).collect()
}
