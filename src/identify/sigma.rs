//! The standard deviation of the lengths: what is given, or what the residuals show.

use std::cmp::Ordering;

use super::covariance::beyond_chance;
use super::fit::Fit;
use super::lengths::Lengths;
use crate::linalg::{Triangle, map_pieces};
use crate::model::{LengthRow, ParamId, Selection};

/// Before the fit: what a linear fit of the base set leaves, or what is given.
pub(super) fn first_sigma(lengths: &Lengths, set_up: &Fit, base: &[ParamId]) -> Vec<f64> {
    if lengths.vouched {
        return lengths.given.clone();
    }
    let selection = Selection::new(base);
    let prepared = set_up.model.prepare();
    let pieces = map_pieces(&lengths.readings, |first, readings| {
        let mut triangle = Triangle::new(base.len());
        let mut row = vec![0.0; base.len()];
        let mut predicted = LengthRow::default();
        for (at, reading) in readings.iter().enumerate().map(|(at, reading)| (first + at, reading)) {
            if set_up.used[at] {
                prepared.row_into(reading, &mut predicted);
                selection.pick(&predicted, reading.centre, &mut row);
                row.iter_mut().for_each(|value| *value /= lengths.given[at]);
                triangle.push(&row, (reading.length - predicted.length) / lengths.given[at]);
            }
        }
        triangle
    });
    let mut triangle = Triangle::merged(pieces, base.len());
    let freedom = set_up.used.iter().filter(|used| **used).count() as f64 - base.len() as f64;
    let ratio = if freedom > 0.0 { triangle.residual_sum() / freedom } else { 1.0 };
    let factor = match beyond_chance(ratio, freedom) {
        _ if !lengths.known => ratio.sqrt().max(FLOOR_MM),
        Some(Ordering::Greater) => ratio.sqrt(),
        _ => 1.0,
    };
    lengths.given.iter().map(|sigma| sigma * factor).collect()
}

/// Lengths are not better than this, mm: it keeps exact data from a division by zero.
const FLOOR_MM: f64 = 1e-9;

/// After the fit: what is given, brought to what the residuals show. Where nothing is known, one
/// sigma for all; where the residuals are larger than the given sigmas and chance, a common further
/// deviation (repeatability, what the model lacks) is added in squares (Paule and Mandel, J. Res.
/// NBS 87, 1982).
pub(super) fn shown_sigma(lengths: &Lengths, fit: &Fit, parameters: usize) -> Vec<f64> {
    if lengths.vouched {
        return lengths.given.clone();
    }
    let prepared = fit.model.prepare();
    let squares: Vec<(f64, f64)> = (0..lengths.readings.len())
        .filter(|&at| fit.used[at])
        .map(|at| {
            let residual = lengths.readings[at].length - prepared.length(&lengths.readings[at]);
            (residual * residual, lengths.given[at] * lengths.given[at])
        })
        .collect();
    let freedom = squares.len() as f64 - parameters as f64;
    if freedom <= 0.0 {
        return lengths.given.clone();
    }
    if !lengths.known {
        let sum: f64 = squares.iter().map(|(r2, _)| r2).sum();
        return vec![(sum / freedom).sqrt().max(FLOOR_MM); lengths.given.len()];
    }
    let chi = |common: f64| squares.iter().map(|(r2, s2)| r2 / (s2 + common)).sum::<f64>();
    if beyond_chance(chi(0.0) / freedom, freedom) != Some(Ordering::Greater) {
        return lengths.given.clone();
    }
    let (mut low, mut high) = (0.0, squares.iter().map(|(r2, _)| r2).sum::<f64>());
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if chi(middle) > freedom { low = middle } else { high = middle }
    }
    lengths.given.iter().map(|sigma| (sigma * sigma + high).sqrt()).collect()
}
