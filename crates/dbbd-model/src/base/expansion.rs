//! Lengths at the reference temperature.

/// Reference temperature of length measurement (ISO 1), degrees Celsius.
pub const REFERENCE_C: f64 = 20.0;

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
}

#[cfg(test)]
mod tests {
    use super::*;

    /// L (1 + 11.5e-6 (25 - 22)) / (1 + 10e-6 (25 - 20)).
    #[test]
    fn lengths_are_referred_to_20_degrees() {
        let expansion =
            ThermalExpansion { bar_per_k: Some(11.5e-6), certified_c: 22.0, machine_per_k: Some(10e-6) };
        let expected = 300.0 * (1.0 + 34.5e-6) / (1.0 + 50e-6);
        assert!((expansion.referred_mm(300.0, 25.0) - expected).abs() < 1e-12);
        let bar = ThermalExpansion { bar_per_k: Some(11.5e-6), ..ThermalExpansion::default() };
        assert!((bar.referred_mm(300.0, 25.0) - 300.0 * (1.0 + 57.5e-6)).abs() < 1e-12);
        assert_eq!(ThermalExpansion::default().referred_mm(300.0, 25.0), 300.0);
    }
}
