//! What two identities state of one measurement, and what of it differs.

use super::identity::{BarIdentity, Identity};

/// Certificates of one bar differ by less, mm.
const OTHER_BAR_MM: f64 = 0.05;
/// Sensors of one temperature differ by less, K.
const OTHER_K: f64 = 0.1;

/// A fact of a measurement that two identities state differently.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Contradiction {
    pub key: String,
    pub known: String,
    pub stated: String,
}

/// A value of an identity.
enum Fact {
    Text(String),
    /// `alike` is the largest difference of two numbers that are one.
    Number {
        value: f64,
        alike: f64,
    },
}

impl Fact {
    /// Both values, where they are not one.
    fn unlike(&self, other: &Self) -> Option<(String, String)> {
        match (self, other) {
            (Self::Text(one), Self::Text(other)) => (one != other).then(|| (one.clone(), other.clone())),
            (Self::Number { value, alike }, Self::Number { value: other, .. }) => {
                ((value - other).abs() > *alike).then(|| (value.to_string(), other.to_string()))
            }
            _ => None,
        }
    }
}

impl BarIdentity {
    /// The key of its length in an identity.
    pub const LENGTH: &str = "bar.length_mm";
    /// And of its serial number.
    pub const SERIAL: &str = "bar.serial";
}

impl Identity {
    /// How the keys of the balls' serial numbers begin.
    pub const BALLS: &str = "balls.";

    /// What another identity states of the same measurement otherwise. People and places may be stated anew.
    pub fn contradictions(&self, stated: &Self) -> Vec<Contradiction> {
        let facts = stated.facts_measured();
        let differs = |(key, known): (String, Fact)| {
            let (_, stated) = facts.iter().find(|(other, _)| *other == key)?;
            let (known, stated) = known.unlike(stated)?;
            Some(Contradiction { key, known, stated })
        };
        self.facts_measured().into_iter().filter_map(differs).collect()
    }

    /// What was measured, and with what, by its key.
    fn facts_measured(&self) -> Vec<(String, Fact)> {
        let Self { robot, controller, load_kg, bar, balls, temperatures, .. } = self;
        let text = |text: &Option<String>| text.clone().map(Fact::Text);
        let number = |value: Option<f64>, alike: f64| value.map(|value| Fact::Number { value, alike });
        let own = [
            ("robot", text(robot)),
            ("controller", text(controller)),
            ("measured", self.day().map(|day| Fact::Text(day.to_owned()))),
            ("load_kg", number(*load_kg, 0.0)),
            (BarIdentity::LENGTH, number(bar.length_mm, OTHER_BAR_MM)),
            ("bar.length_u_mm", number(bar.length_u_mm, 0.0)),
            ("bar.temperature_c", number(bar.temperature_c, 0.0)),
            ("bar.expansion_per_k", number(bar.expansion_per_k, 0.0)),
        ];
        let own = own.map(|(key, fact)| (key.to_owned(), fact));
        let bar = bar.texts().map(|(key, value)| (format!("bar.{key}"), text(value)));
        let balls = balls
            .iter()
            .map(|(ball, serial)| (format!("{}{ball}", Self::BALLS), Some(Fact::Text(serial.clone()))));
        let warm = temperatures.iter().flat_map(|found| {
            let key = |name: &str| format!("{name} of {}", found.of);
            [(key("celsius"), number(Some(found.celsius), OTHER_K)), (key("u_k"), number(found.u_k, 0.0))]
        });
        let all = own.into_iter().chain(bar).chain(balls).chain(warm);
        all.filter_map(|(key, fact)| Some((key, fact?))).collect()
    }
}
