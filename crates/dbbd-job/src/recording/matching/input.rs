//! The input of the matching.

use std::collections::BTreeMap;

use super::alignment::ExpectedLengths;
use super::published::PublishedAxes;
use crate::plan::Plan;
use crate::recording::reports::DwellReport;
use crate::recording::stream::SampleStream;
use dbbd_model::robot::AXES;

/// Measured axis angles, degrees, by the plan's index.
pub type MeasuredAxes = BTreeMap<u32, [f64; AXES]>;

/// A plan with the data that were recorded while it was driven.
#[derive(Clone, Copy, Debug)]
pub struct MatchingInput<'a> {
    pub plan: &'a Plan,
    pub stream: &'a SampleStream,
    /// Reports of the controller in order of arrival; may be empty.
    pub reports: &'a [DwellReport],
    /// Lengths that a model predicts for the dwells of the plan, in order.
    pub expected: Option<ExpectedLengths<'a>>,
    /// Standard deviation of the bar, mm: the least standard deviation of any measurement; 0 if unknown.
    pub bar_sigma_mm: f64,
    /// Measured angles that replace the commanded angles.
    pub axes_deg: Option<&'a MeasuredAxes>,
    /// Published axes: they show the dwells, and replace all other angles.
    pub published: Option<PublishedAxes<'a>>,
}

impl<'a> MatchingInput<'a> {
    pub fn new(plan: &'a Plan, stream: &'a SampleStream) -> Self {
        Self {
            plan,
            stream,
            reports: &[],
            expected: None,
            bar_sigma_mm: 0.0,
            axes_deg: None,
            published: None,
        }
    }
}
