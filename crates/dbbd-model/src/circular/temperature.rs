//! Lengths referred to 20 degrees Celsius.

use super::CircleTrace;

/// Reference temperature of length measurement (ISO 1), degrees Celsius.
pub(super) const REFERENCE_C: f64 = 20.0;

/// Thermal expansion of bar and machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThermalExpansion {
    pub bar_per_k: Option<f64>,
    /// Temperature of the bar's certified length, degrees Celsius.
    pub certified_c: f64,
    pub machine_per_k: Option<f64>,
}

impl Default for ThermalExpansion {
    fn default() -> Self {
        Self { bar_per_k: None, certified_c: REFERENCE_C, machine_per_k: None }
    }
}

impl ThermalExpansion {
    /// Refers a length (bar's length plus reading) measured at `temp_c` to 20 degrees: the warm bar is longer than
    /// certified, and the machine's circle is larger.
    pub fn referred_mm(&self, length_mm: f64, temp_c: f64) -> f64 {
        let bar = 1.0 + self.bar_per_k.unwrap_or(0.0) * (temp_c - self.certified_c);
        let machine = 1.0 + self.machine_per_k.unwrap_or(0.0) * (temp_c - REFERENCE_C);
        length_mm * bar / machine
    }

    /// The traces with corrected lengths; `None` if no expansion is known or a point has no temperature.
    pub(super) fn apply(&self, traces: &[CircleTrace]) -> Option<Vec<CircleTrace>> {
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
