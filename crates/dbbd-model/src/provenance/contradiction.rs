//! Facts of one measurement that two identities state differently.

use super::identity::{BarIdentity, Identity, MeasuredTemperature};

/// Certificates of the same bar differ by less than this, mm.
const OTHER_BAR_MM: f64 = 0.05;
/// Two readings of the same temperature differ by less than this, K.
const OTHER_K: f64 = 0.1;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Contradiction {
    pub key: String,
    pub known: String,
    pub stated: String,
}

enum IdentityFact {
    Text(String),
    /// Two values that differ by at most `tolerance` count as equal.
    Number {
        value: f64,
        tolerance: f64,
    },
}

impl IdentityFact {
    /// Both values as texts, if they differ.
    fn difference(&self, other: &Self) -> Option<(String, String)> {
        match (self, other) {
            (Self::Text(one), Self::Text(other)) => (one != other).then(|| (one.clone(), other.clone())),
            (Self::Number { value, tolerance }, Self::Number { value: other, .. }) => {
                ((value - other).abs() > *tolerance).then(|| (value.to_string(), other.to_string()))
            }
            _ => None,
        }
    }
}

impl BarIdentity {
    /// The key of the bar's length in an identity.
    pub const LENGTH: &str = "bar.length_mm";
    /// The key of the bar's serial number.
    pub const SERIAL: &str = "bar.serial";
}

impl Identity {
    /// The prefix of the keys of the balls' serial numbers.
    pub const BALLS: &str = "balls.";

    /// The facts of the measurement that `stated` contradicts. People and places may differ.
    pub fn contradictions(&self, stated: &Self) -> Vec<Contradiction> {
        let facts = stated.facts_measured();
        let differs = |(key, known): (String, IdentityFact)| {
            let (_, stated) = facts.iter().find(|(other, _)| *other == key)?;
            let (known, stated) = known.difference(stated)?;
            Some(Contradiction { key, known, stated })
        };
        self.facts_measured().into_iter().filter_map(differs).collect()
    }

    /// The facts about the measurement and its equipment, by key.
    fn facts_measured(&self) -> Vec<(String, IdentityFact)> {
        let Self { robot, controller, load_kg, bar, balls, temperatures, .. } = self;
        let text = |text: &Option<String>| text.clone().map(IdentityFact::Text);
        let number =
            |value: Option<f64>, tolerance| value.map(|value| IdentityFact::Number { value, tolerance });
        let own = [
            ("robot", text(robot)),
            ("controller", text(controller)),
            ("measured", self.day().map(|day| IdentityFact::Text(day.to_owned()))),
            ("load_kg", number(*load_kg, 0.0)),
            (BarIdentity::LENGTH, number(bar.length_mm, OTHER_BAR_MM)),
            ("bar.length_u_mm", number(bar.length_u_mm, 0.0)),
            ("bar.temperature_c", number(bar.temperature_c, 0.0)),
            ("bar.expansion_per_k", number(bar.expansion_per_k, 0.0)),
        ];
        let own = own.map(|(key, fact)| (key.to_owned(), fact));
        let bar = bar.texts().map(|(key, value)| (format!("bar.{key}"), text(value)));
        let balls = balls.iter().map(|(ball, serial)| {
            (format!("{}{ball}", Self::BALLS), Some(IdentityFact::Text(serial.clone())))
        });
        let temperatures =
            temperatures.iter().flat_map(|MeasuredTemperature { of, celsius, u_k, .. }| {
                [("celsius", Some(*celsius), OTHER_K), ("u_k", *u_k, 0.0)]
                    .map(|(name, value, tolerance)| (format!("{name} of {of}"), number(value, tolerance)))
            });
        let all = own.into_iter().chain(bar).chain(balls).chain(temperatures);
        all.filter_map(|(key, fact)| Some((key, fact?))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_facts_that_both_state_differently_contradict() {
        let bar = |length_mm, temperature_c| BarIdentity {
            length_mm: Some(length_mm),
            temperature_c,
            ..BarIdentity::default()
        };
        let air = |celsius, u_k| MeasuredTemperature { of: "air".into(), celsius, u_k, device: None };
        let known = Identity {
            robot: Some("R1".into()),
            operator: Some("A".into()),
            load_kg: Some(10.0),
            bar: bar(300.0, Some(20.0)),
            temperatures: vec![air(20.0, None)],
            ..Identity::default()
        };
        let keys = |stated: Identity| -> Vec<String> {
            known.contradictions(&stated).into_iter().map(|found| found.key).collect()
        };
        // Certificates of one bar, and readings of one temperature, may differ a little; people may differ.
        let alike = Identity {
            operator: Some("B".into()),
            bar: bar(300.049, None),
            temperatures: vec![air(20.09, Some(0.5))],
            ..Identity::default()
        };
        assert_eq!(keys(alike), [""; 0]);
        let other = Identity {
            robot: Some("R2".into()),
            load_kg: Some(10.1),
            bar: bar(300.051, Some(21.0)),
            temperatures: vec![air(19.89, None)],
            ..Identity::default()
        };
        assert_eq!(keys(other), ["robot", "load_kg", "bar.length_mm", "bar.temperature_c", "celsius of air"]);
    }
}
