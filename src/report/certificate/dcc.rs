//! The certificate as a Digital Calibration Certificate (PTB, DCC 3.3.0; numbers as D-SI real).

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesEnd, BytesStart, BytesText, Event};

use super::sections::{METHOD, NEVER_DETERMINED};
use super::{Certificate, DRAFT};
use crate::catalogue::CliFinding;
use crate::diagnostic::Diagnostic;
use crate::estimation::result_file::ParameterResult;
use crate::provenance::Temperature;

const VERSION: &str = "3.3.0";
/// Where a DCC needs a text or a date and none is stated.
const NOT_STATED: &str = "not stated";
const NO_DATE: &str = "0001-01-01";
/// ISO 3166-1 leaves it to users: no country is stated.
const NO_COUNTRY: &str = "ZZ";
/// Of an expanded uncertainty with k = 2.
const COVERAGE_PROBABILITY: &str = "0.95";

/// An element with attributes and children, or with a text.
struct Element {
    name: &'static str,
    attributes: Vec<(&'static str, String)>,
    text: Option<String>,
    children: Vec<Element>,
}

fn element(name: &'static str, children: impl IntoIterator<Item = Element>) -> Element {
    Element { name, attributes: Vec::new(), text: None, children: children.into_iter().collect() }
}

fn leaf(name: &'static str, text: impl Into<String>) -> Element {
    Element { text: Some(text.into()), ..element(name, []) }
}

/// A text type of the DCC: a content in English.
fn words(name: &'static str, text: impl Into<String>) -> Element {
    let content = Element { attributes: vec![("lang", "en".into())], ..leaf("dcc:content", text) };
    element(name, [content])
}

pub(super) fn write(certificate: &Certificate) -> Result<Vec<u8>, Diagnostic> {
    let mut writer = Writer::new_with_indent(Vec::new(), b' ', 1);
    event(&mut writer, Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
    put(&mut writer, &document(certificate))?;
    let mut text = writer.into_inner();
    text.push(b'\n');
    Ok(text)
}

fn event(writer: &mut Writer<Vec<u8>>, event: Event<'_>) -> Result<(), Diagnostic> {
    let failed = |why: String| Diagnostic::new(CliFinding::NoOutput { why });
    writer.write_event(event).map_err(|error| failed(error.to_string()))
}

fn put(writer: &mut Writer<Vec<u8>>, of: &Element) -> Result<(), Diagnostic> {
    let attributes = of.attributes.iter().map(|(name, value)| (*name, value.as_str()));
    event(writer, Event::Start(BytesStart::new(of.name).with_attributes(attributes)))?;
    if let Some(text) = &of.text {
        // Characters that XML 1.0 does not have at all.
        let sound: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        event(writer, Event::Text(BytesText::new(&sound)))?;
    }
    of.children.iter().try_for_each(|child| put(writer, child))?;
    event(writer, Event::End(BytesEnd::new(of.name)))
}

fn document(certificate: &Certificate) -> Element {
    let schema = format!("https://ptb.de/dcc https://ptb.de/dcc/v{VERSION}/dcc.xsd");
    Element {
        attributes: vec![
            ("schemaVersion", VERSION.into()),
            ("xmlns:dcc", "https://ptb.de/dcc".into()),
            ("xmlns:si", "https://ptb.de/si".into()),
            ("xmlns:xsi", "http://www.w3.org/2001/XMLSchema-instance".into()),
            ("xsi:schemaLocation", schema),
        ],
        ..element(
            "dcc:digitalCalibrationCertificate",
            [
                element("dcc:administrativeData", administrative(certificate)),
                element("dcc:measurementResults", [measurement(certificate)]),
            ],
        )
    }
}

fn administrative(certificate: &Certificate) -> Vec<Element> {
    let identity = certificate.identity();
    let country = identity.country.as_deref().unwrap_or(NO_COUNTRY);
    let date = identity.measured.as_deref().and_then(|date| date.get(..10)).unwrap_or(NO_DATE);
    let stated = |text: &Option<String>| text.clone().unwrap_or_else(|| NOT_STATED.into());
    let place = || element("dcc:location", [leaf("dcc:countryCode", country)]);
    vec![
        element("dcc:dccSoftware", [software(certificate)]),
        element(
            "dcc:coreData",
            [
                leaf("dcc:countryCodeISO3166_1", country),
                leaf("dcc:usedLangCodeISO639_1", "en"),
                leaf("dcc:mandatoryLangCodeISO639_1", "en"),
                leaf("dcc:uniqueIdentifier", format!("draft-{}", certificate.number)),
                leaf("dcc:beginPerformanceDate", date),
                leaf("dcc:endPerformanceDate", date),
                leaf("dcc:performanceLocation", "other"),
            ],
        ),
        element("dcc:items", [robot(certificate)]),
        element(
            "dcc:calibrationLaboratory",
            [element("dcc:contact", [words("dcc:name", stated(&identity.laboratory)), place()])],
        ),
        element(
            "dcc:respPersons",
            [element(
                "dcc:respPerson",
                [
                    element("dcc:person", [words("dcc:name", stated(&identity.operator))]),
                    leaf("dcc:role", "operator; nobody has signed"),
                    leaf("dcc:mainSigner", "false"),
                ],
            )],
        ),
        element("dcc:customer", [words("dcc:name", stated(&identity.customer)), place()]),
        element("dcc:statements", statements(certificate)),
    ]
}

fn software(certificate: &Certificate) -> Element {
    let release = Some(certificate.provenance.dbbd.as_str()).filter(|text| !text.is_empty());
    let release = leaf("dcc:release", release.unwrap_or(crate::provenance::VERSION));
    element("dcc:software", [words("dcc:name", "dbbd"), release])
}

fn identification(issuer: &str, value: impl Into<String>, name: &str) -> Element {
    let parts = [leaf("dcc:issuer", issuer), leaf("dcc:value", value), words("dcc:name", name)];
    element("dcc:identification", parts)
}

fn robot(certificate: &Certificate) -> Element {
    let identity = certificate.identity();
    let serial = |text: &Option<String>, name| Some(identification("manufacturer", text.clone()?, name));
    let numbers = [
        Some(identification("other", &certificate.number, "first digits of the SHA-256 of result.json")),
        serial(&identity.robot, "serial number of the robot"),
        serial(&identity.controller, "serial number of the controller"),
    ];
    let name = &certificate.result.robot;
    element(
        "dcc:item",
        [
            words("dcc:name", name),
            leaf("dcc:model", name),
            element("dcc:identifications", numbers.into_iter().flatten()),
        ],
    )
}

fn statements(certificate: &Certificate) -> Vec<Element> {
    let draft = format!("{DRAFT}. No good practice guide for robots exists.");
    let bar = &certificate.identity().bar;
    let traceable = bar.certificate.is_some() && bar.length_u_mm.is_some();
    let mut statements = vec![
        element("dcc:statement", [words("dcc:name", "Draft"), words("dcc:declaration", draft)]),
        element(
            "dcc:statement",
            [words("dcc:name", "Traceability of the bar"), leaf("dcc:traceable", traceable.to_string())],
        ),
        element(
            "dcc:statement",
            [
                words("dcc:name", "What was not determined"),
                words("dcc:declaration", NEVER_DETERMINED.join(" ")),
            ],
        ),
    ];
    if let Some(check) = &certificate.check {
        let rule = format!("Decision: {}. Rule: {}.", check.decision, check.rule);
        // A DCC has no word for undecided.
        let decided = ["pass", "fail"].contains(&check.decision.as_str());
        let conformity = decided.then(|| leaf("dcc:conformity", check.decision.as_str()));
        let parts = [
            Some(words("dcc:name", "Conformity")),
            Some(leaf("dcc:norm", "JCGM 106:2012")),
            Some(words("dcc:declaration", rule)),
            conformity,
        ];
        statements.push(Element {
            attributes: vec![("refType", "basic_conformity".into())],
            ..element("dcc:statement", parts.into_iter().flatten())
        });
    }
    statements
}

fn measurement(certificate: &Certificate) -> Element {
    let bar = &certificate.identity().bar;
    let bar_numbers = [
        bar.serial.as_ref().map(|serial| identification("manufacturer", serial, "serial number")),
        bar.certificate.as_ref().map(|number| identification("other", number, "certificate of the length")),
        bar.certified_on.as_ref().map(|date| identification("other", date, "date of the certificate")),
    ];
    let numbers: Vec<Element> = bar_numbers.into_iter().flatten().collect();
    let numbers = (!numbers.is_empty()).then(|| element("dcc:identifications", numbers));
    let equipment = [Some(words("dcc:name", "double ball-bar")), numbers];
    let temperatures: Vec<Element> = certificate.identity().temperatures.iter().map(condition).collect();
    let conditions = (!temperatures.is_empty()).then(|| element("dcc:influenceConditions", temperatures));
    let method =
        element("dcc:usedMethod", [words("dcc:name", "ball-bar lengths"), words("dcc:description", METHOD)]);
    let parts = [
        Some(words("dcc:name", "Kinematic calibration")),
        Some(element("dcc:usedMethods", [method])),
        Some(element("dcc:usedSoftware", [software(certificate)])),
        Some(element(
            "dcc:measuringEquipments",
            [element("dcc:measuringEquipment", equipment.into_iter().flatten())],
        )),
        conditions,
        Some(element("dcc:results", results(certificate))),
    ];
    element("dcc:measurementResult", parts.into_iter().flatten())
}

fn condition(found: &Temperature) -> Element {
    let name = format!("temperature of {}", found.of);
    let quantity = quantity(&name, found.celsius, "\\degreecelsius", found.u_k);
    element("dcc:influenceCondition", [words("dcc:name", name), element("dcc:data", [quantity])])
}

/// A number with its expanded uncertainty (k = 2), where it has one.
fn quantity(name: &str, value: f64, unit: &str, expanded: Option<f64>) -> Element {
    let uncertainty = expanded.map(|u| {
        element(
            "si:measurementUncertaintyUnivariate",
            [element(
                "si:expandedMU",
                [
                    leaf("si:valueExpandedMU", format!("{u}")),
                    leaf("si:coverageFactor", "2"),
                    leaf("si:coverageProbability", COVERAGE_PROBABILITY),
                ],
            )],
        )
    });
    let number = [leaf("si:value", format!("{value}")), leaf("si:unit", unit)];
    element(
        "dcc:quantity",
        [words("dcc:name", name), element("si:real", number.into_iter().chain(uncertainty))],
    )
}

fn results(certificate: &Certificate) -> Vec<Element> {
    const MM: &str = "\\milli\\metre";
    let result = |name: &str, data: Vec<Element>| {
        element("dcc:result", [words("dcc:name", name), element("dcc:data", data)])
    };
    let mm = |name: &str, value: f64| quantity(name, value, MM, None);
    let of = &certificate.result;
    let (residual, predicted) = (&of.residual_mm, &of.predicted_position_error_mm);
    let budget = &certificate.budget;
    let contributions =
        budget.lines.iter().filter_map(|line| Some(mm(line.source.words(), line.position_mm?)));
    let sums = [
        mm("combined standard uncertainty", budget.combined_mm),
        mm("expanded uncertainty (k = 2)", budget.expanded_mm),
    ];
    let mut results = vec![
        result(
            "Position uncertainty over the workspace",
            vec![
                mm("mean", predicted.identified.mean),
                mm("not exceeded by 95 % of the poses", predicted.identified.p95),
                mm("mean of the nominal robot", predicted.nominal.mean),
            ],
        ),
        result(
            "Residual of the lengths",
            vec![
                mm("rms of the nominal robot", residual.before.rms),
                mm("rms of the identified robot", residual.after.rms),
            ],
        ),
        result("Uncertainty budget of the position", contributions.chain(sums).collect()),
    ];
    let identified: Vec<Element> = of.parameters.iter().filter_map(parameter).collect();
    if !identified.is_empty() {
        results.push(result("Identified parameters", identified));
    }
    results
}

/// A parameter that was estimated, with its uncertainty.
fn parameter(found: &ParameterResult) -> Option<Element> {
    let unit = match found.unit.as_str() {
        "mm" => "\\milli\\metre",
        "rad" => "\\radian",
        _ => "\\radian\\newton\\tothe{-1}\\metre\\tothe{-1}",
    };
    Some(quantity(&found.name, found.identified, unit, Some(2.0 * found.sd?)))
}
