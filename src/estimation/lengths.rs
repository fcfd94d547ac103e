//! The lengths as the solver takes them: few are made ready once, many anew for each pass, a piece at a time, so that
//! beside the rows themselves they take no memory.

use std::borrow::Cow;

use super::options::Options;
use crate::math::map_pieces;
use crate::measurement::{Measurement, MeasurementPieces, PreparedMeasurement};
use crate::robot::{AXES, Robot};

/// Lengths of an even sample, which represents many where a scale is asked for, or a start.
pub(super) const SAMPLE: usize = 8192;
/// So many lengths are many.
const MANY: usize = 2 * SAMPLE;

/// Lengths with the standard deviations that are given.
#[derive(Clone, Debug)]
pub(crate) struct Lengths<'a> {
    held: Held<'a>,
    /// Whether the user vouches for their standard deviations, so that these are not brought to what the residuals show.
    pub(super) vouched: bool,
    /// Whether anything is known of them at all.
    pub(super) known: bool,
    /// Standard deviation along a length of what the robot does not repeat, mm, where it is known.
    pub(super) repeatability_mm: Option<f64>,
}

#[derive(Clone, Debug)]
enum Held<'a> {
    /// With the standard deviation of each as given, mm; 1 where nothing is known.
    Few(Vec<PreparedMeasurement>, Vec<f64>),
    /// With one for all, or those of the rows.
    Many(Cow<'a, [Measurement]>, Option<f64>),
}

/// The standard deviation that a length is weighted by, mm, from the one that is given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Sigma {
    /// As given.
    Given,
    /// So many times as large.
    Times(f64),
    /// With a common further deviation of this square, mm^2.
    And(f64),
    /// This one for all.
    All(f64),
}

impl Sigma {
    /// Of a length for which `given` is given.
    pub(super) fn of(self, given: f64) -> f64 {
        match self {
            Self::Given => given,
            Self::Times(factor) => given * factor,
            Self::And(square) => (given * given + square).sqrt(),
            Self::All(sigma) => sigma,
        }
    }
}

/// Lengths as a fit weighs them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weighted<'a> {
    lengths: &'a Lengths<'a>,
    sigma: Sigma,
    /// The places of those that are left out, in order.
    out: &'a [usize],
}

impl<'a> Lengths<'a> {
    /// Of observations, by the sigma that the options or the rows give, on a robot.
    pub(super) fn of(rows: &'a [Measurement], options: &Options, robot: &Robot) -> Self {
        let known = options.sigma_mm.is_some() || rows.iter().all(|row| row.sigma_mm.is_some());
        // One row without a sigma makes all equal: a guess for it would weigh as a measurement.
        let all = options.sigma_mm.or_else(|| (!known).then_some(1.0));
        let held = match rows.len() {
            MANY.. => Held::Many(Cow::Borrowed(rows), all),
            _ => Held::Few(
                rows.iter().map(PreparedMeasurement::from).collect(),
                rows.iter().map(|row| given(row, all)).collect(),
            ),
        };
        let (vouched, repeatability_mm) = (options.sigma_mm.is_some(), robot.repeatability_sd_mm());
        Self { held, vouched, known, repeatability_mm }
    }

    /// Of readings with their standard deviations, mm.
    pub(super) fn few(readings: Vec<PreparedMeasurement>, given: Vec<f64>) -> Lengths<'static> {
        Lengths { held: Held::Few(readings, given), vouched: true, known: true, repeatability_mm: None }
    }

    /// Those at some places.
    pub(super) fn at(&self, places: &[usize]) -> Self {
        let held = match &self.held {
            Held::Few(readings, given) => Held::Few(
                places.iter().map(|&at| readings[at]).collect(),
                places.iter().map(|&at| given[at]).collect(),
            ),
            Held::Many(rows, all) => Held::Many(places.iter().map(|&at| rows[at].clone()).collect(), *all),
        };
        Self { held, ..*self }
    }

    pub(super) fn len(&self) -> usize {
        match &self.held {
            Held::Few(readings, _) => readings.len(),
            Held::Many(rows, _) => rows.len(),
        }
    }

    /// Whether an even sample represents them.
    pub(super) fn are_many(&self) -> bool {
        self.len() >= MANY
    }

    /// Places from one of an even sample to the next; 1 of few, all of which are taken.
    pub(super) fn stride(&self) -> usize {
        if self.are_many() { self.len() / SAMPLE } else { 1 }
    }

    pub(super) fn reading(&self, at: usize) -> PreparedMeasurement {
        match &self.held {
            Held::Few(readings, _) => readings[at],
            Held::Many(rows, _) => PreparedMeasurement::from(&rows[at]),
        }
    }

    /// The axis angles, rad.
    pub(super) fn axes(&self, at: usize) -> [f64; AXES] {
        match &self.held {
            Held::Few(readings, _) => readings[at].axes,
            Held::Many(rows, _) => rows[at].axes.radians(),
        }
    }

    /// The standard deviation that is given, mm; 1 where nothing is known.
    pub(super) fn given(&self, at: usize) -> f64 {
        match &self.held {
            Held::Few(_, sigma) => sigma[at],
            Held::Many(rows, all) => given(&rows[at], *all),
        }
    }

    /// Weighted so, without those `out`.
    pub(super) fn weighted(&'a self, sigma: Sigma, out: &'a [usize]) -> Weighted<'a> {
        Weighted { lengths: self, sigma, out }
    }

    /// All of them as plain lengths.
    pub(super) fn plain(&'a self) -> Weighted<'a> {
        self.weighted(Sigma::All(1.0), &[])
    }
}

/// The standard deviation that is given for a row, mm.
fn given(row: &Measurement, all: Option<f64>) -> f64 {
    all.or(row.sigma_mm).unwrap_or(1.0)
}

impl<'a> Weighted<'a> {
    /// The same by other standard deviations.
    pub(super) fn by(self, sigma: Sigma) -> Self {
        Self { sigma, ..self }
    }

    /// The same without those `out`.
    pub(super) fn without(self, out: &'a [usize]) -> Self {
        Self { out, ..self }
    }

    /// Those that are not left out.
    pub(super) fn count(&self) -> usize {
        self.lengths.len() - self.out.len()
    }

    pub(super) fn lengths(&self) -> &'a Lengths<'a> {
        self.lengths
    }

    /// The standard deviations, mm; infinite of those left out.
    pub(super) fn sigmas(&self) -> impl Iterator<Item = f64> {
        let Self { lengths, sigma, mut out } = *self;
        (0..lengths.len()).map(move |at| match out.split_first() {
            Some((next, others)) if *next == at => {
                out = others;
                f64::INFINITY
            }
            _ => sigma.of(lengths.given(at)),
        })
    }

    /// Root mean square of those that are not left out, mm.
    pub(crate) fn rms_sigma(&self) -> f64 {
        let squares = self.sigmas().filter(|sigma| *sigma != f64::INFINITY).map(|sigma| sigma * sigma);
        (squares.sum::<f64>() / self.count().max(1) as f64).sqrt()
    }

    /// The same of a piece that begins at `first`, from what is given.
    fn weigh(&self, first: usize, given: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut sigma: Vec<f64> = given.map(|given| self.sigma.of(given)).collect();
        for at in &self.out[self.out.partition_point(|at| *at < first)..] {
            let Some(left_out) = sigma.get_mut(at - first) else { break };
            *left_out = f64::INFINITY;
        }
        sigma
    }

    /// What `of` makes of each reading and its standard deviation, of an even sample where they are many.
    pub(crate) fn some<R>(&self, of: impl Fn(&PreparedMeasurement, f64) -> R) -> Vec<R> {
        let stride = self.lengths.stride();
        let placed = self.sigmas().enumerate().step_by(stride);
        placed.map(|(at, sigma)| of(&self.lengths.reading(at), sigma)).collect()
    }

    /// The sum over those that are not left out of what `of` makes of a reading and its standard deviation.
    pub(super) fn sum(&self, of: impl Fn(&PreparedMeasurement, f64) -> f64 + Sync) -> f64 {
        let pieces = self.in_pieces(|_, readings, sigma| {
            let weighed = readings.iter().zip(sigma).filter(|(_, sigma)| **sigma != f64::INFINITY);
            weighed.map(|(reading, sigma)| of(reading, *sigma)).sum::<f64>()
        });
        pieces.into_iter().sum()
    }
}

impl MeasurementPieces for Weighted<'_> {
    /// Few lengths are ready; of many each piece is made ready for one pass.
    fn in_pieces<R: Send>(&self, work: impl Fn(usize, &[PreparedMeasurement], &[f64]) -> R + Sync) -> Vec<R> {
        match &self.lengths.held {
            Held::Few(readings, given) => {
                let sigma = self.weigh(0, given.iter().copied());
                map_pieces(readings, |first, piece| work(first, piece, &sigma[first..first + piece.len()]))
            }
            Held::Many(rows, all) => map_pieces(rows, |first, piece| {
                let readings: Vec<PreparedMeasurement> =
                    piece.iter().map(PreparedMeasurement::from).collect();
                let sigma = self.weigh(first, piece.iter().map(|row| given(row, *all)));
                work(first, &readings, &sigma)
            }),
        }
    }
}
