//! Hypotheses of what happened while the lengths were measured: a table of kinds, compared with each other and with the errors
//! that the model has anyway, at one shared rate of false alarms.
//!
//! A hypothesis adds columns H to the lengths, whose coefficients are N(0, s^2). Beside the posterior at hand, with the columns
//! of unit noise, G = H'P H and g = H'e, its Bayes factor is ln B = g'(G + I/s^2)^-1 g / 2 - ln|I + s^2 G| / 2, the best of six
//! sizes s less ln 6. All kinds and places together have a prior probability of 1 %. The data are never changed: what is
//! certain beyond every rival becomes an unknown of the model, else it is reported with its rivals.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::lengths::Lengths;
use super::pose_rows::PoseRows;
use super::system::{SystemPosterior, Whitened};
use crate::measurement::LengthModel;
use crate::robot::{BallId, BarId, Datum};

/// Prior probability that anything of the table happened.
const ANYTHING: f64 = 0.01;
/// What is certain has these odds against nothing and against every rival.
const CERTAIN_ODDS: f64 = 99.0;
/// Columns with a larger cosine cannot be told apart.
const ALIKE: f64 = 0.9;
/// Sizes that are tried.
const SIZES: usize = 6;
/// Least number of rows before and after a place.
pub(super) const FEWEST: usize = 8;
/// At most so many places are tried, evenly spread.
const MOST_PLACES: usize = 128;
/// Rows beyond which none are tried: so many lengths show what happened in their residuals.
pub(super) const MOST_ROWS: usize = 8192;
/// Hypotheses that may be certain together.
pub(super) const MOST_CERTAIN: usize = 8;

/// What may have happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RunEventKind {
    BarZeroStep,
    BarZeroDrift,
    BaseBallMoved,
    ToolBallMoved,
    TrackerMoved,
    TrackerDrift,
    WrongBall,
    RowsShifted,
    /// All lengths of a ball are off alike: a rival of what begins at its first row.
    BallOffset,
}

impl RunEventKind {
    /// Those that add columns.
    const OF_COLUMNS: [Self; 7] = [
        Self::BarZeroStep,
        Self::BarZeroDrift,
        Self::BaseBallMoved,
        Self::ToolBallMoved,
        Self::TrackerMoved,
        Self::TrackerDrift,
        Self::BallOffset,
    ];

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::BarZeroStep => "a step of the bar's zero",
            Self::BarZeroDrift => "a drift of the bar's zero",
            Self::BaseBallMoved => "a base ball that moved",
            Self::ToolBallMoved => "a tool ball that moved",
            Self::TrackerMoved => "a tracker that moved",
            Self::TrackerDrift => "a tracker that drifted",
            Self::WrongBall => "a wrong ball number",
            Self::RowsShifted => "shifted rows",
            Self::BallOffset => "an error of a ball",
        }
    }

    /// Least and largest size, mm.
    fn sizes_mm(self) -> [f64; 2] {
        match self {
            Self::BarZeroStep | Self::BarZeroDrift | Self::BallOffset => [0.005, 5.0],
            Self::BaseBallMoved | Self::ToolBallMoved | Self::TrackerMoved | Self::TrackerDrift => {
                [0.02, 50.0]
            }
            Self::WrongBall | Self::RowsShifted => [0.0, 0.0],
        }
    }
}

/// What happened and where: the part that it is of, and when it began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RunEvent {
    pub(super) kind: RunEventKind,
    pub(super) bar: Option<BarId>,
    pub(super) ball: Option<BallId>,
    /// Elapsed time of the first row that it concerns, and the place of that row; `None` for all rows.
    pub(super) from: Option<(f64, usize)>,
    /// Whether a drift grows with the length, as that of a bar that warms up, or is the same for all lengths.
    pub(super) grows: bool,
    /// Prior standard deviation of its size, mm.
    pub(super) size_mm: f64,
}

impl RunEvent {
    /// How many columns it adds.
    pub(super) fn columns(&self) -> usize {
        match self.kind {
            RunEventKind::BarZeroStep | RunEventKind::BarZeroDrift | RunEventKind::BallOffset => 1,
            RunEventKind::BaseBallMoved
            | RunEventKind::ToolBallMoved
            | RunEventKind::TrackerMoved
            | RunEventKind::TrackerDrift => 3,
            RunEventKind::WrongBall | RunEventKind::RowsShifted => 0,
        }
    }

    /// Whether a length is of the part that it is of.
    fn is_of(&self, datum: Datum) -> bool {
        match self.kind {
            RunEventKind::TrackerMoved | RunEventKind::TrackerDrift => datum.is_plane(),
            _ if datum.is_plane() => self.kind == RunEventKind::ToolBallMoved,
            _ => {
                self.bar.is_none_or(|bar| datum.bar() == Some(bar))
                    && self.ball.is_none_or(|ball| datum.ball() == Some(ball))
            }
        }
    }

    /// Its columns at the rows, mm per mm.
    pub(super) fn of_rows(&self, rows: &PoseRows, lengths: &Lengths) -> DMatrix<f64> {
        let mut columns = DMatrix::zeros(rows.places.len(), self.columns());
        let sum: f64 = rows.places.iter().map(|place| lengths.reading(*place).length_mm).sum();
        let mean_mm = sum / rows.places.len().max(1) as f64;
        for (row, place) in rows.places.iter().enumerate() {
            let elapsed = lengths.elapsed(*place).unwrap_or(0.0);
            let is_before = self.from.is_some_and(|(from, _)| elapsed < from);
            if is_before || !self.is_of(rows.data[row]) {
                continue;
            }
            let along: [f64; 3] = match self.kind {
                RunEventKind::BarZeroStep | RunEventKind::BallOffset => [1.0, 0.0, 0.0],
                RunEventKind::BarZeroDrift if self.grows => {
                    [elapsed * lengths.reading(*place).length_mm / mean_mm, 0.0, 0.0]
                }
                RunEventKind::BarZeroDrift => [elapsed, 0.0, 0.0],
                RunEventKind::BaseBallMoved => rows.units[row].map(|part| -part),
                RunEventKind::ToolBallMoved => rows.targets[row],
                RunEventKind::TrackerMoved => rows.units[row],
                RunEventKind::TrackerDrift => rows.units[row].map(|part| part * elapsed),
                RunEventKind::WrongBall | RunEventKind::RowsShifted => [0.0; 3],
            };
            (0..self.columns()).for_each(|k| columns[(row, k)] = along[k]);
        }
        columns
    }
}

/// A hypothesis in a result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunHypothesis {
    pub name: RunEventKind,
    #[serde(rename = "where")]
    pub place: EventPlace,
    /// Its size, mm.
    pub size: f64,
    /// Standard deviation of the size, mm.
    pub sd: f64,
    pub probability: f64,
    /// What else explains the same.
    pub rivals: Vec<RunEventKind>,
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
    pub index: Option<u32>,
    /// The rows of a wrong ball number, by their indices.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rows: Vec<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventTreatment {
    /// Certain: it is an unknown of the estimate.
    Unknown,
    /// It could be.
    Reported,
}

/// A hypothesis with its evidence.
#[derive(Clone, Debug)]
pub(super) struct JudgedEvent {
    pub(super) event: RunEvent,
    pub(super) probability: f64,
    /// Coefficients of its columns, mm, and the standard deviation along them.
    pub(super) coefficients: DVector<f64>,
    pub(super) sd_mm: f64,
    pub(super) rivals: Vec<RunEventKind>,
    pub(super) is_certain: bool,
}

/// The best place of a kind, with the logarithms of its prior odds and of its Bayes factor.
#[derive(Clone, Copy, Debug)]
pub(super) struct EventCandidate {
    pub(super) event: RunEvent,
    ln_prior: f64,
    pub(super) ln_bayes: f64,
}

impl EventCandidate {
    fn ln_odds(&self) -> f64 {
        self.ln_prior + self.ln_bayes
    }

    /// Whether it could be an event once its variances are its own.
    pub(super) fn is_worth_a_fit(&self) -> bool {
        const UNLIKELY: f64 = -5.0;
        self.ln_odds() > UNLIKELY
    }

    /// What choosing its size costs.
    pub(super) fn ln_sizes(&self) -> f64 {
        (SIZES as f64).ln()
    }
}

/// A posterior beside which hypotheses are judged.
pub(super) struct EventSearch<'a> {
    pub(super) rows: &'a PoseRows,
    pub(super) whitened: &'a Whitened,
    pub(super) sigma_mm: f64,
    pub(super) lengths: &'a Lengths<'a>,
    known: DMatrix<f64>,
    residual: DVector<f64>,
}

impl<'a> EventSearch<'a> {
    pub(super) fn new(
        rows: &'a PoseRows,
        whitened: &'a Whitened,
        posterior: &SystemPosterior<'_>,
        lengths: &'a Lengths<'a>,
        sigma_mm: f64,
    ) -> Option<Self> {
        let known = &whitened.rows * posterior.root()? / sigma_mm;
        let residual = (&whitened.right - &whitened.rows * &posterior.mean) / sigma_mm;
        Some(Self { rows, whitened, sigma_mm, lengths, known, residual })
    }

    /// The best place of each kind.
    pub(super) fn candidates(&self, among: &[RunEvent]) -> Vec<EventCandidate> {
        let kinds = RunEventKind::OF_COLUMNS.len() as f64;
        let best = |kind: RunEventKind| {
            let events = self.events(kind);
            let ln_prior = (ANYTHING / kinds / events.len().max(1) as f64 / (1.0 - ANYTHING)).ln();
            let is_new =
                |event: &RunEvent| !among.iter().any(|known| known.kind == kind && known.from == event.from);
            let judged = events.into_iter().filter(is_new).filter_map(|event| self.judged(event));
            let (event, ln_bayes) = judged.max_by(|a, b| a.1.total_cmp(&b.1))?;
            Some(EventCandidate { event, ln_prior, ln_bayes })
        };
        RunEventKind::OF_COLUMNS.into_iter().filter_map(best).collect()
    }

    /// The most probable of the candidates, if it is more probable than nothing.
    pub(super) fn strongest(&self, mut best: Vec<EventCandidate>) -> Option<JudgedEvent> {
        best.sort_by(|a, b| b.ln_odds().total_cmp(&a.ln_odds()));
        let exp = |ln: f64| ln.min(300.0).exp();
        let all: f64 = 1.0 + best.iter().map(|candidate| exp(candidate.ln_odds())).sum::<f64>();
        let (first, others) = best.split_first()?;
        let (event, ln_odds) = (first.event, first.ln_odds());
        if ln_odds <= 0.0 || event.kind == RunEventKind::BallOffset {
            return None;
        }
        let margin = CERTAIN_ODDS.ln();
        let is_rival = |other: &&EventCandidate| {
            let other_odds = other.ln_odds();
            other_odds > ln_odds - margin || other_odds > 0.0 && self.cosine(&event, &other.event) > ALIKE
        };
        let rivals: Vec<RunEventKind> =
            others.iter().filter(is_rival).map(|other| other.event.kind).collect();
        let (coefficients, covariance) = self.coefficients(&event)?;
        Some(JudgedEvent {
            event,
            sd_mm: sd_along(&coefficients, &covariance),
            coefficients,
            probability: exp(ln_odds) / all,
            is_certain: ln_odds > margin && rivals.is_empty(),
            rivals,
        })
    }

    /// All hypotheses of a kind.
    fn events(&self, kind: RunEventKind) -> Vec<RunEvent> {
        let mut bars: Vec<BarId> = self.rows.data.iter().filter_map(|datum| datum.bar()).collect();
        let mut balls: Vec<BallId> = self.rows.data.iter().filter_map(|datum| datum.ball()).collect();
        (bars.sort_unstable(), bars.dedup());
        (balls.sort_unstable(), balls.dedup());
        let event = RunEvent { kind, bar: None, ball: None, from: None, grows: false, size_mm: 0.0 };
        let of_bars = || bars.iter().map(|bar| RunEvent { bar: Some(*bar), ..event });
        let of_balls = || balls.iter().map(|ball| RunEvent { ball: Some(*ball), ..event });
        let whole: Vec<RunEvent> = match kind {
            RunEventKind::BarZeroStep | RunEventKind::BarZeroDrift => of_bars().collect(),
            RunEventKind::BaseBallMoved => of_balls().collect(),
            RunEventKind::BallOffset if balls.len() > 1 => of_balls().collect(),
            RunEventKind::BallOffset | RunEventKind::WrongBall | RunEventKind::RowsShifted => Vec::new(),
            RunEventKind::ToolBallMoved | RunEventKind::TrackerMoved | RunEventKind::TrackerDrift => {
                vec![event]
            }
        };
        whole.into_iter().flat_map(|event| self.places(event)).collect()
    }

    /// A hypothesis at all places where it may begin.
    fn places(&self, event: RunEvent) -> Vec<RunEvent> {
        if event.kind == RunEventKind::BallOffset {
            return vec![event];
        }
        let own = (0..self.rows.places.len()).filter(|row| event.is_of(self.rows.data[*row]));
        let timed =
            own.filter_map(|row| Some((self.lengths.elapsed(self.rows.places[row])?, self.rows.places[row])));
        let mut timed: Vec<(f64, usize)> = timed.collect();
        timed.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some(inner) = timed.len().checked_sub(FEWEST).and_then(|last| timed.get(FEWEST..last)) else {
            return Vec::new();
        };
        if matches!(event.kind, RunEventKind::BarZeroDrift | RunEventKind::TrackerDrift) {
            let grown = RunEvent { grows: event.kind == RunEventKind::BarZeroDrift, ..event };
            return if inner.is_empty() { Vec::new() } else { vec![event, grown] };
        }
        let mut first: Vec<(f64, usize)> = inner.to_vec();
        first.dedup_by(|next, before| next.0 == before.0);
        let step = first.len().div_ceil(MOST_PLACES).max(1);
        first.into_iter().step_by(step).map(|from| RunEvent { from: Some(from), ..event }).collect()
    }

    /// Columns of unit noise.
    fn columns(&self, event: &RunEvent) -> DMatrix<f64> {
        let mut columns = event.of_rows(self.rows, self.lengths);
        self.whitened.whitening.apply(&mut columns);
        columns / self.sigma_mm
    }

    /// With its size and the logarithm of its Bayes factor.
    fn judged(&self, event: RunEvent) -> Option<(RunEvent, f64)> {
        let columns = self.columns(&event);
        let explained = self.known.tr_mul(&columns);
        let gram = columns.tr_mul(&columns) - explained.tr_mul(&explained);
        let gradient = columns.tr_mul(&self.residual);
        let [least, most] = event.kind.sizes_mm().map(f64::ln);
        let of_size = |at: usize| {
            let size_mm = (least + (most - least) * at as f64 / (SIZES - 1) as f64).exp();
            let precision = DMatrix::identity(gram.nrows(), gram.nrows()) / (size_mm * size_mm);
            let factor = Cholesky::new(&gram + precision)?;
            let ln_determinant = 2.0 * factor.l_dirty().diagonal().map(f64::ln).sum()
                + 2.0 * gram.nrows() as f64 * size_mm.ln();
            let ln_bayes = 0.5 * gradient.dot(&factor.solve(&gradient)) - 0.5 * ln_determinant;
            ln_bayes.is_finite().then_some((RunEvent { size_mm, ..event }, ln_bayes))
        };
        let best = (0..SIZES).filter_map(of_size).max_by(|a, b| a.1.total_cmp(&b.1))?;
        Some((best.0, best.1 - (SIZES as f64).ln()))
    }

    /// The coefficients of its columns with their covariance.
    fn coefficients(&self, event: &RunEvent) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let columns = self.columns(event);
        let explained = self.known.tr_mul(&columns);
        let gram = columns.tr_mul(&columns) - explained.tr_mul(&explained);
        let precision = &gram + DMatrix::identity(gram.nrows(), gram.nrows()) / event.size_mm.powi(2);
        let covariance = Cholesky::new(precision)?.inverse();
        Some((&covariance * columns.tr_mul(&self.residual), covariance))
    }

    /// Cosine of the angle between what two hypotheses add along their best directions, all other unknowns taken out.
    fn cosine(&self, one: &RunEvent, other: &RunEvent) -> f64 {
        let direction = |event: &RunEvent| -> Option<DVector<f64>> {
            let along = self.columns(event) * self.coefficients(event)?.0;
            let apart = &along - &self.known * self.known.tr_mul(&along);
            (apart.norm() > 0.0).then(|| apart.normalize())
        };
        direction(one).zip(direction(other)).map_or(0.0, |(one, other)| one.dot(&other).abs())
    }
}

/// Standard deviation along a vector.
pub(super) fn sd_along(vector: &DVector<f64>, covariance: &DMatrix<f64>) -> f64 {
    let unit = vector.normalize();
    unit.dot(&(covariance * &unit)).max(0.0).sqrt()
}

impl JudgedEvent {
    /// As a result has it.
    pub(super) fn hypothesis(&self, index: impl Fn(usize) -> u32) -> RunHypothesis {
        let RunEvent { kind, bar, ball, from, .. } = self.event;
        let size = match self.coefficients.len() {
            1 => self.coefficients[0],
            _ => self.coefficients.norm(),
        };
        RunHypothesis {
            name: kind,
            place: EventPlace {
                bar: bar.map(BarId::number),
                ball: ball.map(BallId::number),
                index: from.map(|(_, place)| index(place)),
                rows: Vec::new(),
            },
            size,
            sd: self.sd_mm,
            probability: self.probability,
            rivals: self.rivals.clone(),
            treated: if self.is_certain { EventTreatment::Unknown } else { EventTreatment::Reported },
        }
    }
}

/// Whether so many rows of `count` with a wrong ball number are more than chance, at a standard deviation of a length (mm).
pub(super) fn are_wrong_balls(rows: usize, count: usize, sd_mm: f64) -> bool {
    /// Lengths to different balls differ by up to so much, mm.
    const RANGE_MM: f64 = 1000.0;
    let rows = rows as f64;
    let ln_bayes = rows * (RANGE_MM / (2.0 * FITS * sd_mm) / count as f64).ln();
    let kinds = RunEventKind::OF_COLUMNS.len() as f64;
    ln_bayes + (ANYTHING / kinds).ln() > CERTAIN_ODDS.ln()
}

/// A length fits within so many standard deviations, those of its prediction included.
const FITS: f64 = 6.0;

/// Rows that were left out as outliers, and whose lengths fit another ball: with that ball.
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
