//! Hypotheses of events while the lengths were measured: a table of kinds, compared with each other and with the errors
//! that the model has anyway, at one shared rate of false alarms.
//!
//! A hypothesis adds columns H to the design rows, whose coefficients are N(0, s^2). With L the inverse of the rows'
//! covariance, P the projection that eliminates the other unknowns and e the residuals, G = H'L P H and g = H'L e. The
//! Bayes factor is ln B = g'(G + I/s^2)^-1 g / 2 - ln|I + s^2 G| / 2, the best of six sizes s less ln 6. All kinds and
//! places together have a prior probability of 1 %. The data are never changed: an event that is certain and has no
//! rival becomes an unknown of the model, others are reported with their rivals.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::lengths::Lengths;
use super::pose_rows::PoseRows;
use super::system::{SystemPosterior, Whitened};
use crate::measurement::LengthModel;
use crate::robot::{BallId, BarId, Datum, Joint};

/// Prior probability that anything of the table happened.
const ANYTHING: f64 = 0.01;
/// A certain event has these odds against no event and against every rival.
const CERTAIN_ODDS: f64 = 99.0;
/// Columns with a larger cosine are alike.
const ALIKE: f64 = 0.9;
/// Sizes that are tried.
const SIZES: usize = 6;
/// Milliradians of a radian.
pub(super) const MRAD: f64 = 1e3;
/// Least number of rows before and after a place.
pub(super) const MIN_LENGTHS: usize = 8;
/// Largest number of certain hypotheses.
pub(super) const MAX_CERTAIN: usize = 8;

/// A kind of event that may have happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SupposedEventKind {
    BarZeroStep,
    BarZeroDrift,
    BaseBallMoved,
    ToolBallMoved,
    /// The zero of an axis changed: the arm was hit.
    JointZeroStep,
    TrackerMoved,
    TrackerDrift,
    WrongBall,
    /// All lengths to a ball have the same error: a rival of events that begin at the ball's first row.
    BallOffset,
}

impl SupposedEventKind {
    /// The kinds that add columns.
    const OF_COLUMNS: [Self; 8] = [
        Self::BarZeroStep,
        Self::BarZeroDrift,
        Self::BaseBallMoved,
        Self::ToolBallMoved,
        Self::JointZeroStep,
        Self::TrackerMoved,
        Self::TrackerDrift,
        Self::BallOffset,
    ];

    /// The name in words, the unit of the size, the least and largest size, and the number of columns.
    const fn description(self) -> (&'static str, &'static str, [f64; 2], usize) {
        const SLIGHT: [f64; 2] = [0.005, 5.0];
        const LARGE: [f64; 2] = [0.02, 50.0];
        match self {
            Self::BarZeroStep => ("a step of the bar's zero", "mm", SLIGHT, 1),
            Self::BarZeroDrift => ("a drift of the bar's zero", "mm", SLIGHT, 1),
            Self::BaseBallMoved => ("a base ball that moved", "mm", LARGE, 3),
            Self::ToolBallMoved => ("a tool ball that moved", "mm", LARGE, 3),
            Self::JointZeroStep => ("a step of an axis's zero", "mrad", LARGE, 1),
            Self::TrackerMoved => ("a tracker that moved", "mm", LARGE, 3),
            Self::TrackerDrift => ("a tracker that drifted", "mm", LARGE, 3),
            Self::WrongBall => ("a wrong ball number", "mm", [0.0; 2], 0),
            Self::BallOffset => ("an error of a ball", "mm", SLIGHT, 1),
        }
    }

    /// The name in words.
    pub fn name(self) -> &'static str {
        let (name, ..) = self.description();
        name
    }

    /// Unit of the size.
    pub(super) fn unit(self) -> &'static str {
        let (_, unit, ..) = self.description();
        unit
    }

    /// Least and largest size, in the unit of the kind.
    fn sizes(self) -> [f64; 2] {
        let (.., sizes, _) = self.description();
        sizes
    }
}

/// An event: its kind, the part that it concerns, and when it began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SupposedEvent {
    pub(super) kind: SupposedEventKind,
    pub(super) bar: Option<BarId>,
    pub(super) ball: Option<BallId>,
    pub(super) joint: Option<Joint>,
    /// Elapsed time of the first row that the event concerns, and the place of that row; `None` for all rows.
    pub(super) from: Option<(f64, usize)>,
    /// The length, mm, that a drift in proportion to the length changes by the event's size, as of a bar that warms up;
    /// `None` if the drift is the same for all lengths.
    pub(super) grown_mm: Option<f64>,
    /// Prior standard deviation of the event's size, mm; for the zero of an axis mrad.
    pub(super) size: f64,
}

impl SupposedEvent {
    /// Number of columns that the event adds.
    pub(super) fn columns(&self) -> usize {
        let (.., columns) = self.kind.description();
        columns
    }

    /// Whether another event has the same kind, part and row.
    fn is_of_place(&self, other: &Self) -> bool {
        let place = |event: &Self| (event.kind, event.bar, event.ball, event.joint, event.from);
        place(self) == place(other)
    }

    /// Whether a length is measured with the part that the event concerns.
    fn is_of(&self, datum: Datum) -> bool {
        let is_of_tracker =
            matches!(self.kind, SupposedEventKind::TrackerMoved | SupposedEventKind::TrackerDrift);
        if datum.is_plane() {
            return is_of_tracker
                || matches!(self.kind, SupposedEventKind::ToolBallMoved | SupposedEventKind::JointZeroStep);
        }
        !is_of_tracker
            && self.bar.is_none_or(|bar| datum.bar() == Some(bar))
            && self.ball.is_none_or(|ball| datum.ball() == Some(ball))
    }

    /// The columns of the event at the rows, mm per unit of its size.
    pub(super) fn of_rows(&self, rows: &PoseRows, lengths: &Lengths) -> DMatrix<f64> {
        let mut columns = DMatrix::zeros(rows.lengths.len(), self.columns());
        for (row, length) in rows.lengths.iter().enumerate() {
            let elapsed = lengths.elapsed(length.place).unwrap_or(0.0);
            let is_before = self.from.is_some_and(|(from, _)| elapsed < from);
            if is_before || !self.is_of(rows.lengths[row].datum) {
                continue;
            }
            let along: [f64; 3] = match self.kind {
                SupposedEventKind::BarZeroStep | SupposedEventKind::BallOffset => [1.0, 0.0, 0.0],
                SupposedEventKind::BarZeroDrift => {
                    let length_mm = lengths.reading(length.place).length_mm;
                    [elapsed * self.grown_mm.map_or(1.0, |grown_mm| length_mm / grown_mm), 0.0, 0.0]
                }
                SupposedEventKind::BaseBallMoved => rows.lengths[row].unit.map(|part| -part),
                SupposedEventKind::ToolBallMoved => rows.lengths[row].target,
                SupposedEventKind::JointZeroStep => {
                    let by = self.joint.map_or(0.0, |joint| length.by_joint[joint.index()]);
                    [by / MRAD, 0.0, 0.0]
                }
                SupposedEventKind::TrackerMoved => rows.lengths[row].unit,
                SupposedEventKind::TrackerDrift => rows.lengths[row].unit.map(|part| part * elapsed),
                SupposedEventKind::WrongBall => [0.0; 3],
            };
            (0..self.columns()).for_each(|k| columns[(row, k)] = along[k]);
        }
        columns
    }
}

/// A hypothesis in a result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunHypothesis {
    pub name: SupposedEventKind,
    #[serde(rename = "where")]
    pub place: EventPlace,
    /// Size of the event, mm; for the zero of an axis mrad.
    pub size: f64,
    /// Standard deviation of the size, in the same unit.
    pub sd: f64,
    pub probability: f64,
    /// Other events that explain the same lengths.
    pub rivals: Vec<SupposedEventKind>,
    pub treated: EventTreatment,
}

/// The part that a hypothesis is about, and the index of the first row.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EventPlace {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bar: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ball: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub index: Option<u32>,
    /// The rows of a wrong ball number, by their indices.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rows: Vec<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventTreatment {
    /// The event is certain: it is an unknown of the estimate.
    Unknown,
    /// The event is possible: it is only reported.
    Reported,
}

/// A hypothesis with its evidence.
#[derive(Clone, Debug)]
pub(super) struct JudgedEvent {
    pub(super) event: SupposedEvent,
    pub(super) probability: f64,
    /// Coefficients of the event's columns, and the standard deviation along them, mm; for the zero of an axis mrad.
    pub(super) coefficients: DVector<f64>,
    pub(super) sd: f64,
    pub(super) rivals: Vec<SupposedEventKind>,
    pub(super) is_certain: bool,
}

/// The best place of a kind, with the logarithms of its prior odds and of its Bayes factor.
#[derive(Clone, Copy, Debug)]
pub(super) struct EventCandidate {
    pub(super) event: SupposedEvent,
    ln_prior: f64,
    pub(super) ln_bayes: f64,
}

impl EventCandidate {
    fn ln_odds(&self) -> f64 {
        self.ln_prior + self.ln_bayes
    }

    /// Whether the event could become probable when the variances are fitted to it.
    pub(super) fn is_worth_a_fit(&self) -> bool {
        const UNLIKELY: f64 = -5.0;
        self.ln_odds() > UNLIKELY
    }

    /// The loss of evidence for the choice of the size, as a logarithm.
    pub(super) fn ln_sizes(&self) -> f64 {
        (SIZES as f64).ln()
    }
}

/// A posterior to which hypotheses are added to judge them.
pub(super) struct EventSearch<'a> {
    rows: &'a PoseRows,
    lengths: &'a Lengths<'a>,
    /// The inverse of the rows' covariance, 1/mm^2: for each row the rows of its pose.
    weights: Vec<Vec<(usize, f64)>>,
    /// The other unknowns: G = H'L H - (K'H)'(K'H) for these columns K.
    known: DMatrix<f64>,
    /// The weighted residuals L e, 1/mm.
    residual: DVector<f64>,
}

/// Sums over the rows of a hypothesis. An event that begins a row earlier has the same sums and one row more.
struct EventSums<'a> {
    search: &'a EventSearch<'a>,
    columns: &'a DMatrix<f64>,
    /// Whether a row is in the sums.
    is_in: Vec<bool>,
    gram: DMatrix<f64>,
    /// K'H.
    explained: DMatrix<f64>,
    /// H'L e.
    gradient: DVector<f64>,
}

impl<'a> EventSums<'a> {
    /// No row yet of these columns.
    fn none(search: &'a EventSearch<'a>, columns: &'a DMatrix<f64>) -> Self {
        Self {
            search,
            columns,
            is_in: vec![false; columns.nrows()],
            gram: DMatrix::zeros(columns.ncols(), columns.ncols()),
            explained: DMatrix::zeros(search.known.ncols(), columns.ncols()),
            gradient: DVector::zeros(columns.ncols()),
        }
    }

    fn of(search: &'a EventSearch<'a>, columns: &'a DMatrix<f64>) -> Self {
        let mut sums = Self::none(search, columns);
        (0..columns.nrows()).for_each(|row| sums.add(row));
        sums
    }

    fn add(&mut self, row: usize) {
        let own = self.columns.row(row);
        if own.iter().all(|value| *value == 0.0) {
            return;
        }
        for (other, weight) in &self.search.weights[row] {
            if *other == row {
                self.gram.ger(*weight, &own.transpose(), &own.transpose(), 1.0);
            } else if self.is_in[*other] {
                let other = self.columns.row(*other).transpose();
                self.gram.ger(*weight, &own.transpose(), &other, 1.0);
                self.gram.ger(*weight, &other, &own.transpose(), 1.0);
            }
        }
        self.explained.ger(1.0, &self.search.known.row(row).transpose(), &own.transpose(), 1.0);
        self.gradient += own.transpose() * self.search.residual[row];
        self.is_in[row] = true;
    }

    /// The matrix G.
    fn information(&self) -> DMatrix<f64> {
        &self.gram - self.explained.tr_mul(&self.explained)
    }
}

impl<'a> EventSearch<'a> {
    pub(super) fn new(
        rows: &'a PoseRows,
        whitened: &Whitened,
        posterior: &SystemPosterior<'_>,
        lengths: &'a Lengths<'a>,
        sigma_mm: f64,
    ) -> Option<Self> {
        let variance = sigma_mm * sigma_mm;
        let mut known = posterior.rows_by_root(&whitened.rows)? / sigma_mm;
        let mut residual = (&whitened.right - &whitened.rows * &posterior.mean) / variance;
        whitened.whitening.apply_transpose(&mut known);
        whitened.whitening.apply_transpose(&mut residual);
        let mut weights = vec![Vec::new(); rows.lengths.len()];
        for (rows, of_pose) in whitened.whitening.weights() {
            for (row, of_row) in rows.iter().zip(of_pose.row_iter()) {
                weights[*row] =
                    rows.iter().copied().zip(of_row.iter().map(|weight| weight / variance)).collect();
            }
        }
        Some(Self { rows, lengths, weights, known, residual })
    }

    /// The best place of each kind.
    pub(super) fn candidates(&self, among: &[SupposedEvent]) -> Vec<EventCandidate> {
        let kinds = SupposedEventKind::OF_COLUMNS.len() as f64;
        let best = |kind: SupposedEventKind| {
            let parts = self.events(kind);
            let count = parts.iter().map(Vec::len).sum::<usize>().max(1);
            let ln_prior = (ANYTHING / kinds / count as f64 / (1.0 - ANYTHING)).ln();
            let of_parts = parts.iter().filter_map(|places| self.best_place(places, among));
            let (event, ln_bayes) = of_parts.max_by(|a, b| a.1.total_cmp(&b.1))?;
            Some(EventCandidate { event, ln_prior, ln_bayes })
        };
        SupposedEventKind::OF_COLUMNS.into_iter().filter_map(best).collect()
    }

    /// The most probable of the events that differ by their beginning, without those `among` the unknowns.
    fn best_place(&self, places: &[SupposedEvent], among: &[SupposedEvent]) -> Option<(SupposedEvent, f64)> {
        let is_known = |event: &SupposedEvent| among.iter().any(|known| known.is_of_place(event));
        let whole = SupposedEvent { from: None, ..*places.first()? };
        let columns = whole.of_rows(self.rows, self.lengths);
        let elapsed = |row: usize| self.lengths.elapsed(self.rows.lengths[row].place).unwrap_or(0.0);
        let mut later: Vec<(f64, usize)> = (0..columns.nrows()).map(|row| (elapsed(row), row)).collect();
        later.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut sums = EventSums::none(self, &columns);
        let judged = |event: &SupposedEvent| {
            while let Some((_, row)) =
                later.pop_if(|(elapsed, _)| event.from.is_none_or(|(from, _)| *elapsed >= from))
            {
                sums.add(row);
            }
            if is_known(event) { None } else { of_best_size(*event, &sums) }
        };
        places.iter().rev().filter_map(judged).max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The most probable event, if it is more probable than no event. The offset of a ball is not an event; if it
    /// explains the lengths better, only an event that resembles it is reported.
    pub(super) fn strongest(&self, candidates: Vec<EventCandidate>) -> Option<JudgedEvent> {
        let margin = CERTAIN_ODDS.ln();
        let is_rival = |of: &EventCandidate, other: &EventCandidate| {
            let other_odds = other.ln_odds();
            other_odds > of.ln_odds() - margin
                || other_odds > 0.0 && self.cosine(&of.event, &other.event) > ALIKE
        };
        let most = candidates.iter().map(EventCandidate::ln_odds).fold(0.0, f64::max);
        let exp = |ln: f64| (ln - most).exp();
        let all: f64 = exp(0.0) + candidates.iter().map(|candidate| exp(candidate.ln_odds())).sum::<f64>();
        let (offsets, mut events): (Vec<_>, Vec<_>) = candidates
            .into_iter()
            .partition(|candidate| candidate.event.kind == SupposedEventKind::BallOffset);
        events.sort_by(|a, b| b.ln_odds().total_cmp(&a.ln_odds()));
        let (first, others) = events.split_first()?;
        if first.ln_odds() <= 0.0 || offsets.iter().any(|offset| !is_rival(offset, first)) {
            return None;
        }
        let rivals = offsets.iter().chain(others).filter(|other| is_rival(first, other));
        let rivals: Vec<SupposedEventKind> = rivals.map(|other| other.event.kind).collect();
        let (coefficients, covariance) = self.coefficients(&first.event)?;
        Some(JudgedEvent {
            event: first.event,
            sd: sd_along(&coefficients, &covariance),
            coefficients,
            probability: exp(first.ln_odds()) / all,
            is_certain: first.ln_odds() > margin && rivals.is_empty(),
            rivals,
        })
    }

    /// All hypotheses of a kind: for each part that it may concern the places, in their order.
    fn events(&self, kind: SupposedEventKind) -> Vec<Vec<SupposedEvent>> {
        let mut bars: Vec<BarId> = self.rows.lengths.iter().filter_map(|length| length.datum.bar()).collect();
        let mut balls: Vec<BallId> =
            self.rows.lengths.iter().filter_map(|length| length.datum.ball()).collect();
        bars.sort_unstable();
        bars.dedup();
        balls.sort_unstable();
        balls.dedup();
        let event =
            SupposedEvent { kind, bar: None, ball: None, joint: None, from: None, grown_mm: None, size: 0.0 };
        let of_bars = || bars.iter().map(|bar| SupposedEvent { bar: Some(*bar), ..event });
        let of_balls = || balls.iter().map(|ball| SupposedEvent { ball: Some(*ball), ..event });
        let whole: Vec<SupposedEvent> = match kind {
            SupposedEventKind::BarZeroStep => of_bars().collect(),
            SupposedEventKind::BarZeroDrift => {
                let sum_mm: f64 =
                    self.rows.lengths.iter().map(|length| self.lengths.reading(length.place).length_mm).sum();
                let grown_mm = Some(sum_mm / self.rows.lengths.len() as f64);
                of_bars().flat_map(|event| [event, SupposedEvent { grown_mm, ..event }]).collect()
            }
            SupposedEventKind::BaseBallMoved => of_balls().collect(),
            SupposedEventKind::BallOffset if balls.len() > 1 => of_balls().collect(),
            SupposedEventKind::JointZeroStep => {
                Joint::ALL.iter().map(|joint| SupposedEvent { joint: Some(*joint), ..event }).collect()
            }
            SupposedEventKind::BallOffset | SupposedEventKind::WrongBall => Vec::new(),
            SupposedEventKind::ToolBallMoved
            | SupposedEventKind::TrackerMoved
            | SupposedEventKind::TrackerDrift => {
                vec![event]
            }
        };
        whole.into_iter().map(|event| self.places(event)).collect()
    }

    /// A hypothesis at all places where it may begin.
    fn places(&self, event: SupposedEvent) -> Vec<SupposedEvent> {
        if event.kind == SupposedEventKind::BallOffset {
            return vec![event];
        }
        let own = (0..self.rows.lengths.len()).filter(|row| event.is_of(self.rows.lengths[*row].datum));
        let timed = own.filter_map(|row| {
            Some((self.lengths.elapsed(self.rows.lengths[row].place)?, self.rows.lengths[row].place))
        });
        let mut timed: Vec<(f64, usize)> = timed.collect();
        timed.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some(inner) = timed.len().checked_sub(MIN_LENGTHS).and_then(|last| timed.get(MIN_LENGTHS..last))
        else {
            return Vec::new();
        };
        if matches!(event.kind, SupposedEventKind::BarZeroDrift | SupposedEventKind::TrackerDrift) {
            return if inner.is_empty() { Vec::new() } else { vec![event] };
        }
        let mut first: Vec<(f64, usize)> = inner.to_vec();
        first.dedup_by(|next, before| next.0 == before.0);
        first.into_iter().map(|from| SupposedEvent { from: Some(from), ..event }).collect()
    }

    /// The coefficients of the event's columns with their covariance.
    fn coefficients(&self, event: &SupposedEvent) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let columns = event.of_rows(self.rows, self.lengths);
        let sums = EventSums::of(self, &columns);
        let prior = DMatrix::identity(event.columns(), event.columns()) / event.size.powi(2);
        let covariance = Cholesky::new(sums.information() + prior)?.inverse();
        Some((&covariance * &sums.gradient, covariance))
    }

    /// Cosine of the angle between the effects of two hypotheses on the lengths, each along its best direction, with
    /// all other unknowns eliminated.
    fn cosine(&self, one: &SupposedEvent, other: &SupposedEvent) -> f64 {
        let along = |event: &SupposedEvent| {
            let (coefficients, _) = self.coefficients(event)?;
            Some(event.of_rows(self.rows, self.lengths) * coefficients)
        };
        let Some((one, other)) = along(one).zip(along(other)) else { return 0.0 };
        let information = EventSums::of(self, &DMatrix::from_columns(&[one, other])).information();
        let cosine = information[(0, 1)].abs() / (information[(0, 0)] * information[(1, 1)]).sqrt();
        if cosine.is_finite() { cosine } else { 0.0 }
    }
}

/// The event with its best size, and the logarithm of its Bayes factor.
fn of_best_size(event: SupposedEvent, sums: &EventSums<'_>) -> Option<(SupposedEvent, f64)> {
    let information = sums.information();
    let [least, most] = event.kind.sizes().map(f64::ln);
    let of_size = |at: usize| {
        let size = (least + (most - least) * at as f64 / (SIZES - 1) as f64).exp();
        let precision = DMatrix::identity(event.columns(), event.columns()) / (size * size);
        let factor = Cholesky::new(&information + precision)?;
        let ln_determinant =
            2.0 * factor.l_dirty().diagonal().map(f64::ln).sum() + 2.0 * event.columns() as f64 * size.ln();
        let ln_bayes = 0.5 * sums.gradient.dot(&factor.solve(&sums.gradient)) - 0.5 * ln_determinant;
        ln_bayes.is_finite().then_some((SupposedEvent { size, ..event }, ln_bayes))
    };
    let best = (0..SIZES).filter_map(of_size).max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some((best.0, best.1 - (SIZES as f64).ln()))
}

/// Standard deviation along a vector.
pub(super) fn sd_along(vector: &DVector<f64>, covariance: &DMatrix<f64>) -> f64 {
    let unit = vector.normalize();
    unit.dot(&(covariance * &unit)).max(0.0).sqrt()
}

impl JudgedEvent {
    /// The hypothesis in the form of a result.
    pub(super) fn hypothesis(&self, index: impl Fn(usize) -> u32) -> RunHypothesis {
        let SupposedEvent { kind, bar, ball, joint, from, .. } = self.event;
        let size = match self.coefficients.len() {
            1 => self.coefficients[0],
            _ => self.coefficients.norm(),
        };
        RunHypothesis {
            name: kind,
            place: EventPlace {
                bar: bar.map(BarId::number),
                ball: ball.map(BallId::number),
                joint: joint.map(Joint::number),
                index: from.map(|(_, place)| index(place)),
                rows: Vec::new(),
            },
            size,
            sd: self.sd,
            probability: self.probability,
            rivals: self.rivals.clone(),
            treated: if self.is_certain { EventTreatment::Unknown } else { EventTreatment::Reported },
        }
    }
}

/// Whether this number of rows (of `count`) with a wrong ball number is more than chance, at a standard deviation of a
/// length (mm).
pub(super) fn are_wrong_balls(rows: usize, count: usize, sd_mm: f64) -> bool {
    /// Lengths to different balls differ by up to this, mm.
    const RANGE_MM: f64 = 1000.0;
    let rows = rows as f64;
    let ln_bayes = rows * (RANGE_MM / (2.0 * FITS * sd_mm) / count as f64).ln();
    let kinds = SupposedEventKind::OF_COLUMNS.len() as f64;
    ln_bayes + (ANYTHING / kinds).ln() > CERTAIN_ODDS.ln()
}

/// A length fits if its residual is below this many standard deviations, those of its prediction included.
const FITS: f64 = 6.0;

/// The rows that were left out as outliers and whose lengths fit another ball, each with that ball.
pub(super) fn wrong_balls(
    model: &LengthModel,
    lengths: &Lengths,
    outliers: &[usize],
    sd_mm: f64,
) -> Vec<(usize, BallId)> {
    let prepared = model.prepare();
    let fitting = |at: usize| {
        let Datum::Ball(own, bar) = lengths.reading(at).datum else { return None };
        let off = |ball: usize| {
            let mut other = lengths.reading(at);
            other.datum = Datum::Ball(BallId::at(ball), bar);
            prepared.residual(&other).abs()
        };
        let others = (0..model.balls.len()).filter(|ball| *ball != own.index());
        let nearest = others.min_by(|a, b| off(*a).total_cmp(&off(*b)))?;
        (off(nearest) < FITS * sd_mm && off(own.index()) > FITS * sd_mm).then_some((at, BallId::at(nearest)))
    };
    outliers.iter().filter_map(|at| fitting(*at)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::hyper_parameters::{Group, Hypers, Variance};
    use super::super::noise_shape::{JointNoise, NoiseShape, OwnNoise};
    use super::super::system::System;
    use super::super::tests::cell_of_poses::{hypers, model, normals, readings};
    use super::*;
    use crate::estimation::Options;
    use crate::measurement::{Measurement, PreparedMeasurement, Tracker};
    use crate::robot::{Coordinate, ParamId};
    use crate::test_support::cell::kr60;

    const SIGMA_MM: f64 = 0.03;
    const SHAPE: NoiseShape = NoiseShape { own: OwnNoise::Stated(0.01), joints: JointNoise::NONE };

    /// Rows of readings as a table has them, measured one after the other.
    fn table(readings: &[PreparedMeasurement]) -> Vec<Measurement> {
        (1..).zip(readings).map(|(index, one)| Measurement::of_prepared(index, one)).collect()
    }

    fn pose_rows(model: &LengthModel, lengths: &Lengths, ids: &[ParamId]) -> PoseRows {
        PoseRows::at(model, &lengths.plain(), ids, |_| None)
    }

    const GROWN_MM: f64 = 400.0;

    fn event(kind: SupposedEventKind, from: Option<(f64, usize)>) -> SupposedEvent {
        SupposedEvent {
            kind,
            bar: None,
            ball: None,
            joint: None,
            from,
            grown_mm: (kind == SupposedEventKind::BarZeroDrift).then_some(GROWN_MM),
            size: 0.5,
        }
    }

    /// Columns are the effect on the lengths of a small move of a part of the model.
    #[test]
    fn columns_are_the_differences_of_the_model() {
        let tracker = Tracker {
            origin: nalgebra::Vector3::new(2500.0, 300.0, 100.0),
            turn: nalgebra::Vector3::zeros(),
        };
        let model = LengthModel { tracker: Some(tracker), ..model(2) };
        let mut all = readings(&model, 20, 1);
        for (at, reading) in all.iter_mut().enumerate().skip(30) {
            reading.datum = Datum::Plane(Coordinate::ALL[at % 3]);
        }
        let (rows, options, robot) = (table(&all), Options::default(), kr60());
        let lengths = Lengths::of(&rows, &options, &robot);
        let at = pose_rows(&model, &lengths, &[]);
        let step = 1e-4;
        let from = Some((10.0 / 39.0, 10));
        let moved = |id: ParamId| {
            let mut moved = model.clone();
            moved.shift(id, step);
            all.iter()
                .map(|one| (moved.prepare().length(one) - model.prepare().length(one)) / step)
                .collect::<Vec<f64>>()
        };
        let mut of_second = event(SupposedEventKind::BaseBallMoved, from);
        of_second.ball = Some(BallId::at(1));
        let ball = |axis| ParamId::Ball(BallId::at(1), axis);
        let tracker = |axis| moved(ParamId::Tracker(axis)).into_iter().map(|mm| -mm).collect::<Vec<f64>>();
        for (event, expected) in [
            (of_second, Coordinate::ALL.map(|axis| moved(ball(axis)))),
            (
                event(SupposedEventKind::ToolBallMoved, from),
                Coordinate::ALL.map(|axis| moved(ParamId::Tool(axis))),
            ),
            // A tracker that moved sees the target moved to the other side.
            (event(SupposedEventKind::TrackerMoved, from), Coordinate::ALL.map(tracker)),
        ] {
            let found = event.of_rows(&at, &lengths);
            assert_eq!(found.ncols(), 3);
            for (column, expected) in expected.iter().enumerate() {
                for row in 0..40 {
                    let expected = if row < 10 { 0.0 } else { expected[row] };
                    let off = (found[(row, column)] - expected).abs();
                    assert!(
                        off < 1e-6,
                        "{:?} {row} {column}: {} {expected}",
                        event.kind,
                        found[(row, column)]
                    );
                }
            }
        }
        let mut of_axis = event(SupposedEventKind::JointZeroStep, from);
        of_axis.joint = Some(Joint::J3);
        let (of_axis, expected) = (of_axis.of_rows(&at, &lengths), moved(ParamId::Theta(Joint::J3)));
        for row in 0..40 {
            let expected = if row < 10 { 0.0 } else { expected[row] / 1e3 };
            assert!((of_axis[row] - expected).abs() < 1e-3, "{row}: {} {expected}", of_axis[row]);
        }
        let bar = moved(ParamId::BarOffset(BarId::FIRST));
        let step_of_bar = event(SupposedEventKind::BarZeroStep, from).of_rows(&at, &lengths);
        let drift = event(SupposedEventKind::BarZeroDrift, None).of_rows(&at, &lengths);
        let drifted = event(SupposedEventKind::TrackerDrift, None).of_rows(&at, &lengths);
        let mut second = event(SupposedEventKind::BallOffset, None);
        second.ball = Some(BallId::at(1));
        let offset = second.of_rows(&at, &lengths);
        for row in 0..40 {
            let elapsed = row as f64 / 39.0;
            assert!((step_of_bar[row] - if row < 10 { 0.0 } else { bar[row] }).abs() < 1e-6, "{row}");
            assert!((drift[row] - elapsed * bar[row] * all[row].length_mm / GROWN_MM).abs() < 1e-6, "{row}");
            let is_second = all[row].datum.ball() == Some(BallId::at(1));
            assert_eq!(offset[row], if is_second { 1.0 } else { 0.0 });
            let own = all[row].datum.is_plane();
            let along: f64 = drifted.row(row).norm();
            assert!((along - if own { elapsed } else { 0.0 }).abs() < 1e-12, "{row}");
        }
    }

    struct Bench {
        readings: Vec<PreparedMeasurement>,
        hypers: Hypers,
    }

    impl Bench {
        /// 80 lengths with a step of the bar's zero at a row.
        fn new(step: Option<(usize, f64)>) -> Self {
            Self::of_poses(40, step)
        }

        fn of_poses(poses: usize, step: Option<(usize, f64)>) -> Self {
            let model = model(2);
            let mut readings = readings(&model, poses, 1);
            let noise = normals(readings.len(), 9) * SIGMA_MM;
            for (at, (reading, noise)) in readings.iter_mut().zip(&noise).enumerate() {
                reading.length_mm += noise + step.filter(|(from, _)| at >= *from).map_or(0.0, |(_, mm)| mm);
            }
            Self { readings, hypers: hypers(SIGMA_MM) }
        }

        fn with<R>(&self, of: impl Fn(&EventSearch<'_>, &System) -> R) -> R {
            let (rows, options, robot, model) = (table(&self.readings), Options::default(), kr60(), model(2));
            let lengths = Lengths::of(&rows, &options, &robot);
            let balls =
                (0..2).flat_map(|ball| Coordinate::ALL.map(|axis| ParamId::Ball(BallId::at(ball), axis)));
            let mut ids: Vec<ParamId> = balls.collect();
            ids.extend([ParamId::A(Joint::J2), ParamId::BarOffset(BarId::FIRST)]);
            ids.sort();
            let at = pose_rows(&model, &lengths, &ids);
            let variance = |id: &ParamId| match id {
                ParamId::A(_) => Variance::Of(Group::Tolerance, 0.5),
                _ => Variance::Fixed(0.5),
            };
            let system = System {
                right: at.residual.clone(),
                weights: vec![1.0; at.lengths.len()],
                rows: at,
                variances: ids.iter().map(|id| Some(variance(id))).collect(),
                is_sigma_given: false,
                sigma_mm: SIGMA_MM,
            };
            let whitened = system.whitened(SHAPE, SIGMA_MM).unwrap();
            let posterior = whitened.equations.posterior(&self.hypers).unwrap();
            let search = EventSearch::new(&system.rows, &whitened, &posterior, &lengths, SIGMA_MM).unwrap();
            of(&search, &system)
        }
    }

    fn judged(search: &EventSearch<'_>, event: SupposedEvent) -> (SupposedEvent, f64) {
        let columns = event.of_rows(search.rows, search.lengths);
        of_best_size(event, &EventSums::of(search, &columns)).unwrap()
    }

    /// ln N(y; 0, V + s^2 H H') - ln N(y; 0, V), with V the covariance of noise and all unknowns: the best of six sizes.
    #[test]
    fn bayes_factor_is_that_of_the_dense_covariances() {
        Bench::new(Some((40, 0.05))).with(|search, system| {
            let rows = &system.rows;
            let count = rows.lengths.len();
            let mut v = DMatrix::<f64>::zeros(count, count);
            for pose in &rows.poses {
                for (i, j) in pose.iter().flat_map(|i| pose.iter().map(move |j| (*i, *j))) {
                    let cosine: f64 = (0..3).map(|k| rows.lengths[i].unit[k] * rows.lengths[j].unit[k]).sum();
                    v[(i, j)] += SIGMA_MM * SIGMA_MM * cosine + if i == j { 0.01 * 0.01 } else { 0.0 };
                }
            }
            for (column, variance) in rows.values.column_iter().zip(&system.variances) {
                v += column * column.transpose() * variance.unwrap().value(&hypers(SIGMA_MM));
            }
            let ln_density = |v: &DMatrix<f64>| {
                let factor = Cholesky::new(v.clone()).unwrap();
                let ln_determinant = 2.0 * factor.l_dirty().diagonal().map(f64::ln).sum();
                -0.5 * (ln_determinant + system.right.dot(&factor.solve(&system.right)))
            };
            let from = Some((40.0 / 79.0, 40));
            for kind in [
                SupposedEventKind::BarZeroStep,
                SupposedEventKind::BarZeroDrift,
                SupposedEventKind::ToolBallMoved,
            ] {
                let (event, found) = judged(search, event(kind, from));
                let h = event.of_rows(rows, search.lengths);
                let [least, most] = kind.sizes().map(f64::ln);
                let of_size = |at: usize| {
                    let size = (least + (most - least) * at as f64 / 5.0).exp();
                    (ln_density(&(&v + &h * h.transpose() * (size * size))) - ln_density(&v), size)
                };
                let (best, size) = (0..6).map(of_size).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
                assert!(
                    (found - (best - 6f64.ln())).abs() < 1e-6 * best.abs().max(1.0),
                    "{kind:?}: {found} {best}"
                );
                assert!((event.size / size - 1.0).abs() < 1e-12);
            }
        });
    }

    /// The sums that grow by a row have the evidence of the event's own columns, between the rows of a pose too.
    #[test]
    fn evidence_of_each_place_is_that_of_the_event_alone() {
        Bench::new(Some((41, 0.05))).with(|search, _| {
            for kind in [SupposedEventKind::BarZeroStep, SupposedEventKind::ToolBallMoved] {
                for places in search.events(kind) {
                    assert_eq!(places.len(), 64);
                    for place in &places {
                        let (found, ln_bayes) = search.best_place(&[*place], &[]).unwrap();
                        let (alone, ln_bayes_alone) = judged(search, *place);
                        assert_eq!(found, alone);
                        assert!((ln_bayes - ln_bayes_alone).abs() < 1e-9 * ln_bayes_alone.abs().max(1.0));
                    }
                }
            }
        });
    }

    #[test]
    fn a_step_is_found_at_its_place_and_noise_has_none() {
        Bench::new(Some((42, 0.3))).with(|search, _| {
            let found = search.strongest(search.candidates(&[])).unwrap();
            assert_eq!(found.event.kind, SupposedEventKind::BarZeroStep);
            assert_eq!(found.event.from.map(|(_, place)| place), Some(42));
            assert!(found.is_certain && found.probability > 0.99 && found.rivals.is_empty(), "{found:?}");
            assert!((found.coefficients[0] - 0.3).abs() < 4.0 * found.sd, "{found:?}");
            // An event that is already an unknown is not found again.
            let again = search.strongest(search.candidates(&[found.event]));
            assert!(again.is_none_or(|other| other.event.from != found.event.from));
        });
        assert!(Bench::new(None).with(|search, _| search.strongest(search.candidates(&[])).is_none()));
    }

    #[test]
    fn a_step_is_found_at_its_row_of_many() {
        for place in [8, 9, 120, 121, 230, 231] {
            Bench::of_poses(120, Some((place, 0.3))).with(|search, _| {
                let found = search.strongest(search.candidates(&[])).unwrap();
                assert_eq!(found.event.from.map(|(_, found)| found), Some(place));
                assert!((found.coefficients[0] - 0.3).abs() < 4.0 * found.sd, "{found:?}");
            });
        }
    }

    /// One ball after the other: a step between them adds the column of an offset of the second ball.
    fn stepped_between_balls() -> Bench {
        let mut bench = Bench::new(None);
        bench.readings.sort_by_key(|reading| reading.datum.ball());
        bench.readings[40..].iter_mut().for_each(|reading| reading.length_mm += 0.3);
        bench
    }

    #[test]
    fn a_step_that_an_offset_of_a_ball_explains_is_not_certain() {
        stepped_between_balls().with(|search, _| {
            let step = SupposedEvent {
                bar: Some(BarId::FIRST),
                ..event(SupposedEventKind::BarZeroStep, Some((40.0 / 79.0, 40)))
            };
            let offset =
                SupposedEvent { ball: Some(BallId::at(1)), ..event(SupposedEventKind::BallOffset, None) };
            let [of_step, of_offset] = [step, offset].map(|event| judged(search, event));
            assert!(
                (of_step.1 - of_offset.1).abs() < 1e-9 && of_step.1 > 10.0,
                "{} {}",
                of_step.1,
                of_offset.1
            );
            assert!((search.cosine(&of_step.0, &of_offset.0) - 1.0).abs() < 1e-9);
            assert!(search.strongest(search.candidates(&[])).is_none_or(|found| !found.is_certain));
        });
    }

    #[test]
    fn a_step_that_an_offset_of_a_ball_explains_is_reported() {
        stepped_between_balls().with(|search, _| {
            let found = search.strongest(search.candidates(&[])).unwrap();
            assert!(!found.is_certain && found.event.kind != SupposedEventKind::BallOffset, "{found:?}");
            assert!(found.rivals.contains(&SupposedEventKind::BallOffset), "{found:?}");
        });
    }

    #[test]
    fn lengths_that_fit_another_ball_have_its_number() {
        let model = model(3);
        let all = readings(&model, 10, 1);
        let mut wrong = all.clone();
        // Measured to the third ball, written down as the first; one is off by no ball's length.
        for at in [3, 9, 24] {
            wrong[at].length_mm = all[at + 2].length_mm + 0.02;
        }
        wrong[12].length_mm += 7.0;
        let lengths = Lengths::few(wrong, vec![1.0; 30]);
        let found = wrong_balls(&model, &lengths, &[3, 9, 12, 24], 0.05);
        assert_eq!(found, [(3, BallId::at(2)), (9, BallId::at(2)), (24, BallId::at(2))]);
        // By chance one of 30 lengths fits another ball within 0.6 mm of a metre with a probability of 30 / 1667: three have
        // ln B = 3 ln 55.6 = 12.1, against ln 700 = 6.6 of the prior and ln 99 = 4.6; two have 8.0.
        assert!(
            are_wrong_balls(3, 30, 0.05) && !are_wrong_balls(2, 30, 0.05) && !are_wrong_balls(0, 30, 0.05)
        );
        // Of very many lengths, those that fit another ball within millimetres are chance.
        assert!(!are_wrong_balls(50, 10_000, 1.0));
    }
}
