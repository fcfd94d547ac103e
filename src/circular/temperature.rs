//! Lengths referred to 20 degrees Celsius.

use super::Trace;

/// Reference temperature of length measurement (ISO 1), degrees Celsius.
pub(super) const REFERENCE_C: f64 = 20.0;

/// How lengths depend on temperature. Both expansions are 0 when nothing is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Temperature {
    pub bar_per_k: Option<f64>,
    /// Temperature at which the bar's length was certified, degrees Celsius.
    pub certified_c: f64,
    pub machine_per_k: Option<f64>,
}

impl Default for Temperature {
    fn default() -> Self {
        Self { bar_per_k: None, certified_c: REFERENCE_C, machine_per_k: None }
    }
}

impl Temperature {
    /// A length (bar's length plus reading, mm) measured at `temp_c`: the warm bar is longer than its
    /// certificate says, and the machine's circle is larger than at 20 degrees.
    pub fn referred_mm(&self, length_mm: f64, temp_c: f64) -> f64 {
        let bar = 1.0 + self.bar_per_k.unwrap_or(0.0) * (temp_c - self.certified_c);
        let machine = 1.0 + self.machine_per_k.unwrap_or(0.0) * (temp_c - REFERENCE_C);
        length_mm * bar / machine
    }

    /// The traces with their lengths referred; `None` when no expansion is known or a point has no
    /// temperature.
    pub(super) fn apply(&self, traces: &[Trace]) -> Option<Vec<Trace>> {
        if self.bar_per_k.is_none() && self.machine_per_k.is_none() {
            return None;
        }
        let mut referred = traces.to_vec();
        for point in referred.iter_mut().flat_map(|trace| &mut trace.points) {
            point.length_mm = self.referred_mm(point.length_mm, point.temp_c?);
        }
        Some(referred)
    }
}
