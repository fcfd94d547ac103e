//! Who measured what, where and under which conditions.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::catalogue::IdentityFinding::{
    self, ControlInText, EmptyText, LongText, NotACountry, NotADate, TooEarly,
};
use crate::base::date::{day_number, is_after, is_moment};
use crate::base::expansion::{REFERENCE_C, ThermalExpansion};
use crate::base::parse::from_toml;
use crate::base::text::is_control;
use crate::diagnostic::Diagnostic;
use crate::plausibility::Quantity;
use crate::provenance::ProvenanceFinding;

/// The country codes of ISO 3166-1, as the time zone database lists them (public domain).
const COUNTRIES: &str = "AD AE AF AG AI AL AM AO AQ AR AS AT AU AW AX AZ BA BB BD BE BF BG BH BI BJ BL BM BN BO BQ BR BS BT \
    BV BW BY BZ CA CC CD CF CG CH CI CK CL CM CN CO CR CU CV CW CX CY CZ DE DJ DK DM DO DZ EC EE EG EH \
    ER ES ET FI FJ FK FM FO FR GA GB GD GE GF GG GH GI GL GM GN GP GQ GR GS GT GU GW GY HK HM HN HR HT \
    HU ID IE IL IM IN IO IQ IR IS IT JE JM JO JP KE KG KH KI KM KN KP KR KW KY KZ LA LB LC LI LK LR LS \
    LT LU LV LY MA MC MD ME MF MG MH MK ML MM MN MO MP MQ MR MS MT MU MV MW MX MY MZ NA NC NE NF NG NI \
    NL NO NP NR NU NZ OM PA PE PF PG PH PK PL PM PN PR PS PT PW PY QA RE RO RS RU RW SA SB SC SD SE SG \
    SH SI SJ SK SL SM SN SO SR SS ST SV SX SY SZ TC TD TF TG TH TJ TK TL TM TN TO TR TT TV TW TZ UA UG \
    UM US UY UZ VA VC VE VG VI VN VU WF WS YE YT ZA ZM ZW";
/// No measurement with a ball-bar, and no certificate of a bar in use, is older.
const EARLIEST: &str = "1980-01-01";
/// The longest text, characters.
const MAX_TEXT_CHARACTERS: usize = 200;

/// Serial numbers, people, places and conditions of a measurement, as far as they are stated: the table `[identity]` of a
/// job or of the service's configuration, or a separate file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Identity {
    /// Serial number of the robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub robot: Option<String>,
    /// Serial number of its controller.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub controller: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cell: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub laboratory: Option<String>,
    /// The country of the laboratory by ISO 3166-1, two capital letters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub country: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub customer: Option<String>,
    /// Date, or date and time in UTC; of a capture by the clock of the recording computer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured: Option<String>,
    /// Mass at the flange, kg.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub load_kg: Option<f64>,
    #[serde(skip_serializing_if = "BarIdentity::is_empty")]
    pub bar: BarIdentity,
    /// Serial numbers of the base balls by ball number.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub balls: BTreeMap<String, String>,
    #[serde(rename = "temperature", skip_serializing_if = "Vec::is_empty")]
    pub temperatures: Vec<MeasuredTemperature>,
}

/// The bar and its certificate.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BarIdentity {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Number of the certificate of its length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certificate: Option<String>,
    /// Date of the certificate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certified_on: Option<String>,
    /// The laboratory that issued it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certified_by: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub length_mm: Option<f64>,
    /// Expanded uncertainty (k = 2) of the length, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub length_u_mm: Option<f64>,
    /// Temperature of the certified length, degrees Celsius.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Thermal expansion, 1/K.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expansion_per_k: Option<f64>,
}

/// A temperature during the measurement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredTemperature {
    /// The part that has the temperature: `air`, `bar`, `robot`, ..
    pub of: String,
    /// Mean, degrees Celsius.
    pub celsius: f64,
    /// Expanded uncertainty (k = 2), K.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub u_k: Option<f64>,
    /// The thermometer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
}

/// A key, and what is wrong with its value.
pub type IdentityError = (&'static str, Diagnostic);

/// Refuses a text that is empty, longer than 200 characters, or has control characters or bidirectional controls.
pub fn check_text(key: &'static str, text: Option<&String>) -> Result<(), IdentityError> {
    let Some(text) = text else { return Ok(()) };
    let length = text.trim().chars().count();
    let wrong = if let Some(control) = text.chars().find(|c| is_control(*c)) {
        ControlInText { key: key.into(), code: format!("U+{:04X}", u32::from(control)) }
    } else if length == 0 {
        EmptyText { key: key.into() }
    } else if length > MAX_TEXT_CHARACTERS {
        LongText { key: key.into(), length, most: MAX_TEXT_CHARACTERS }
    } else {
        return Ok(());
    };
    Err((key, wrong.into()))
}

/// The day number of a date with or without a time.
fn day(moment: &str) -> Option<f64> {
    day_number(moment.split('T').next()?)
}

/// Refuses a text that is not a date, or date and time, since 1980.
fn check_date(key: &'static str, date: Option<&String>) -> Result<(), IdentityError> {
    match date {
        Some(date) if !is_moment(date) => Err((key, NotADate { key: key.into(), date: date.clone() }.into())),
        Some(date) if day(date) < day_number(EARLIEST) => {
            Err((key, TooEarly { key: key.into(), date: date.clone() }.into()))
        }
        _ => Ok(()),
    }
}

fn check_value(key: &'static str, value: Option<f64>, quantity: Quantity) -> Result<(), IdentityError> {
    value.map_or(Ok(()), |value| quantity.check(key, value)).map_err(|finding| (key, finding.into()))
}

impl MeasuredTemperature {
    pub fn check(&self) -> Result<(), IdentityError> {
        check_text("of", Some(&self.of))?;
        check_text("device", self.device.as_ref())?;
        check_value("celsius", Some(self.celsius), Quantity::Temperature)?;
        check_value("u_k", self.u_k, Quantity::TemperatureUncertainty)
    }
}

impl BarIdentity {
    fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    pub(super) fn texts(&self) -> [(&'static str, &Option<String>); 4] {
        [
            ("serial", &self.serial),
            ("certificate", &self.certificate),
            ("certified_on", &self.certified_on),
            ("certified_by", &self.certified_by),
        ]
    }

    /// Standard uncertainty of the length, mm: a certificate states two standard deviations.
    pub fn u_mm(&self) -> Option<f64> {
        self.length_u_mm.map(|u| 0.5 * u)
    }

    /// Temperature of the certified length, degrees Celsius: most certificates are at the reference temperature.
    fn certified_c(&self) -> f64 {
        self.temperature_c.unwrap_or(REFERENCE_C)
    }

    /// The correction of a length for temperature; `None` if the expansion is not given.
    pub fn expansion(&self) -> Option<ThermalExpansion> {
        let (bar_per_k, certified_c) = (Some(self.expansion_per_k?), self.certified_c());
        Some(ThermalExpansion { bar_per_k, certified_c, machine_per_k: None })
    }

    /// A finding if the expansion of the bar is not given and, for steel, the change of length from the certificate's
    /// temperature to `mean_c` exceeds the uncertainty of the certificate.
    pub fn uncorrected(&self, length_mm: f64, mean_c: f64) -> Option<IdentityFinding> {
        /// Most bars are of steel.
        const STEEL_PER_K: f64 = 11.5e-6;
        /// The uncertainty (k = 2) of a length without a certificate, mm.
        const UNKNOWN_U_MM: f64 = 0.02;
        let longer_mm = length_mm * STEEL_PER_K * (mean_c - self.certified_c());
        let u_mm = self.length_u_mm.unwrap_or(UNKNOWN_U_MM);
        (self.expansion_per_k.is_none() && longer_mm.abs() > u_mm).then(|| {
            let (longer_um, u_um) = (1e3 * longer_mm, 1e3 * u_mm);
            IdentityFinding::ExpansionNotGiven { mean_c, longer_um, u_um }
        })
    }

    pub fn check(&self) -> Result<(), IdentityError> {
        self.texts().into_iter().try_for_each(|(key, text)| check_text(key, text.as_ref()))?;
        check_date("certified_on", self.certified_on.as_ref())?;
        check_value("length_mm", self.length_mm, Quantity::BarLength)?;
        check_value("length_u_mm", self.length_u_mm, Quantity::ExpandedLengthUncertainty)?;
        check_value("temperature_c", self.temperature_c, Quantity::CertificateTemperature)?;
        check_value("expansion_per_k", self.expansion_per_k, Quantity::Expansion)
    }
}

impl Identity {
    /// The day of the measurement.
    pub fn day(&self) -> Option<&str> {
        self.measured.as_ref()?.split('T').next()
    }

    /// Standard uncertainty of the bar's length by the uncertainty of its temperature, u = L alpha u(T), mm.
    pub fn bar_temperature_u_mm(&self) -> Option<f64> {
        let of_bar = self.temperatures.iter().find(|found| found.of == "bar").and_then(|found| found.u_k);
        let per_k = self.bar.length_mm.zip(self.bar.expansion_per_k);
        per_k.zip(of_bar).map(|((length, per_k), u_k)| length * per_k.abs() * 0.5 * u_k)
    }

    /// Standard uncertainty of the bar's length, mm, from its temperature and from `certified_mm` or else the
    /// certificate.
    pub fn bar_u_mm(&self, certified_mm: Option<f64>) -> Option<f64> {
        let certified_mm = certified_mm.or(self.bar.u_mm())?;
        Some(certified_mm.hypot(self.bar_temperature_u_mm().unwrap_or(0.0)))
    }

    /// Reads an identity from a separate file.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        let identity: Self = from_toml(file, text)?;
        identity.check_all().map_err(|(_, finding)| finding.in_file(file))?;
        Ok(identity)
    }

    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// The serial numbers of robot and controller, which remain the same in later measurements.
    pub fn of_robot(&self) -> Self {
        Self { robot: self.robot.clone(), controller: self.controller.clone(), ..Self::default() }
    }

    fn texts(&self) -> [(&'static str, &Option<String>); 7] {
        [
            ("robot", &self.robot),
            ("controller", &self.controller),
            ("cell", &self.cell),
            ("laboratory", &self.laboratory),
            ("country", &self.country),
            ("operator", &self.operator),
            ("customer", &self.customer),
        ]
    }

    /// Checks everything except bar and temperatures, which a job has in tables of their own.
    pub fn check(&self) -> Result<(), IdentityError> {
        self.texts().into_iter().try_for_each(|(key, text)| check_text(key, text.as_ref()))?;
        self.check_balls()?;
        check_date("measured", self.measured.as_ref())?;
        if let Some(code) = self.country.as_ref()
            && !COUNTRIES.split(' ').any(|known| known == code)
        {
            return Err(("country", NotACountry { code: code.clone() }.into()));
        }
        check_value("load_kg", self.load_kg, Quantity::Load)
    }

    fn check_balls(&self) -> Result<(), IdentityError> {
        let mut known: Vec<&String> = Vec::new();
        for (ball, serial) in &self.balls {
            check_text("balls", Some(serial))?;
            if ball.parse::<u32>().ok().is_none_or(|number| number == 0 || number.to_string() != *ball) {
                return Err(("balls", IdentityFinding::NotABall { key: ball.clone() }.into()));
            }
            if known.contains(&serial) {
                return Err(("balls", IdentityFinding::SerialTwice { serial: serial.clone() }.into()));
            }
            known.push(serial);
        }
        Ok(())
    }

    /// Refuses dates after `today` (nanoseconds since the Unix epoch), with a day of tolerance for time zones.
    pub fn check_dates(&self, today: u64) -> Result<(), IdentityError> {
        let dates = [("measured", &self.measured), ("certified_on", &self.bar.certified_on)];
        for (key, date) in dates {
            let Some(date) = date else { continue };
            if is_after(date.split('T').next().unwrap_or_default(), today) {
                return Err((key, IdentityFinding::InFuture { key: key.into(), date: date.clone() }.into()));
            }
        }
        Ok(())
    }

    /// A finding if the certificate of the bar was old at the time of the measurement, or is today if that is not known.
    pub fn old_certificate(&self, today: &str) -> Option<ProvenanceFinding> {
        /// Length standards are certified again after one or two years.
        const YEARS: f64 = 2.0;
        let certified = self.bar.certified_on.as_ref()?;
        let years = (day(self.measured.as_deref().unwrap_or(today))? - day(certified)?) / 365.25;
        (years > YEARS).then(|| ProvenanceFinding::OldCertificate { date: certified.clone(), years })
    }

    /// Checks all values, and that values which depend on each other are consistent.
    pub fn check_all(&self) -> Result<(), IdentityError> {
        self.check()?;
        self.bar.check()?;
        if let (Some(certified), Some(measured)) = (&self.bar.certified_on, &self.measured)
            && day(certified) > day(measured)
        {
            return Err(("certified_on", IdentityFinding::CertifiedLater { date: certified.clone() }.into()));
        }
        for (at, found) in self.temperatures.iter().enumerate() {
            found.check()?;
            if self.temperatures[..at].iter().any(|other| other.of == found.of) {
                return Err((
                    "temperature",
                    IdentityFinding::TemperatureTwice { of: found.of.clone() }.into(),
                ));
            }
        }
        Ok(())
    }

    /// Replaces the values that `other` states.
    pub fn extend(&mut self, other: &Self) {
        fn take<T: Clone>(mine: &mut Option<T>, theirs: &Option<T>) {
            if theirs.is_some() {
                mine.clone_from(theirs);
            }
        }
        take(&mut self.robot, &other.robot);
        take(&mut self.controller, &other.controller);
        take(&mut self.cell, &other.cell);
        take(&mut self.laboratory, &other.laboratory);
        take(&mut self.country, &other.country);
        take(&mut self.operator, &other.operator);
        take(&mut self.customer, &other.customer);
        take(&mut self.measured, &other.measured);
        take(&mut self.load_kg, &other.load_kg);
        let (mine, theirs) = (&mut self.bar, &other.bar);
        take(&mut mine.serial, &theirs.serial);
        take(&mut mine.certificate, &theirs.certificate);
        take(&mut mine.certified_on, &theirs.certified_on);
        take(&mut mine.certified_by, &theirs.certified_by);
        take(&mut mine.length_mm, &theirs.length_mm);
        take(&mut mine.length_u_mm, &theirs.length_u_mm);
        take(&mut mine.temperature_c, &theirs.temperature_c);
        take(&mut mine.expansion_per_k, &theirs.expansion_per_k);
        self.balls.extend(other.balls.clone());
        self.temperatures.retain(|found| other.temperatures.iter().all(|newer| newer.of != found.of));
        self.temperatures.extend(other.temperatures.iter().cloned());
    }

    /// Everything that is stated, as names and values to print.
    pub fn facts(&self) -> Vec<(String, String)> {
        let names = [
            "serial number of the robot",
            "serial number of the controller",
            "cell",
            "laboratory",
            "country",
            "operator",
            "customer",
            "serial number of the bar",
            "certificate of the bar",
            "date of the certificate",
            "issued by",
        ];
        let named = names.into_iter().zip(self.texts().into_iter().chain(self.bar.texts()));
        let texts = named.filter_map(|(name, (_, text))| Some((name.to_owned(), text.clone()?)));
        let mut facts: Vec<_> =
            self.measured.iter().map(|date| ("measured".to_owned(), date.clone())).chain(texts).collect();
        let BarIdentity { length_mm, length_u_mm, temperature_c, expansion_per_k, .. } = self.bar;
        if let Some(length) = length_mm {
            let u = length_u_mm.map_or_else(String::new, |u| format!(", U = {u} mm (k = 2)"));
            let at = temperature_c.map_or_else(String::new, |c| format!(" at {c} °C"));
            let by = expansion_per_k.map_or_else(String::new, |per_k| format!(", expansion {per_k:e} 1/K"));
            facts.push(("length of the bar".into(), format!("{length} mm{at}{u}{by}")));
        }
        let balls = self.balls.iter();
        facts.extend(balls.map(|(ball, serial)| (format!("serial number of ball {ball}"), serial.clone())));
        facts.extend(self.load_kg.map(|kg| ("load at the flange".to_owned(), format!("{kg} kg"))));
        facts.extend(self.temperatures.iter().map(|found| {
            let u = found.u_k.map_or_else(String::new, |u| format!(" ± {u} K (k = 2)"));
            let by = found.device.as_ref().map_or_else(String::new, |device| format!(", {device}"));
            (format!("temperature of {}", found.of), format!("{:.2} °C{u}{by}", found.celsius))
        }));
        facts
    }
}
