//! The certificate: its budget adds up, its three forms say the same, and other programs read them.

use std::fs;
use std::path::Path;
use std::process::Output;

use dbbd_model::base::serialised;
use serde_json::Value;
use tempfile::{TempDir, tempdir};

use crate::cell::{
    CENTRE, DESIGNED, centres_csv, client, codes, dbbd, horizontal, kr60, measure, stderr, with_errors,
};

const IDENTITY: &str = "robot = 'KR-1'\nlaboratory = 'Lab <&> 1'\ncountry = 'DE'\noperator = 'A. Example'\ncustomer = 'Plant 7'\n\
    measured = '2026-03-31'\n[bar]\nserial = 'B-1'\ncertificate = 'K-77'\ncertified_on = '2026-03-01'\ncertified_by = 'Length lab'\n\
    length_mm = 300.0\nlength_u_mm = 0.002\nexpansion_per_k = 12e-6\n[[temperature]]\nof = 'bar'\ncelsius = 20.4\nu_k = 0.2\n";

/// Lengths of a robot with errors, with noise, and what was stated of them.
fn cell() -> TempDir {
    let dir = tempdir().unwrap();
    let circle = [horizontal(1, CENTRE)];
    let mut lengths = measure(&with_errors(DESIGNED), &circle, 60, 25.0);
    for (at, row) in lengths.rows.iter_mut().enumerate() {
        row.length_mm += 0.004 * ((at as f64 * 12.9898).sin() * 43758.5453).fract();
        row.sigma_mm = Some(0.002);
    }
    fs::write(dir.path().join("robot.toml"), kr60().to_toml().unwrap()).unwrap();
    fs::write(dir.path().join("obs.csv"), lengths.to_csv()).unwrap();
    fs::write(dir.path().join("C.csv"), centres_csv(&circle)).unwrap();
    fs::write(dir.path().join("identity.toml"), IDENTITY).unwrap();
    dir
}

fn identify(dir: &Path, out: &str, more: &[&str]) -> Value {
    let args =
        ["identify", "obs.csv", "--robot", "robot.toml", "--centres", "C.csv", "--folds", "0", "--out", out];
    let output = dbbd(dir, &[&args[..], &["--identity", "identity.toml"], more].concat());
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
    serde_json::from_str(&fs::read_to_string(dir.join(out).join("result.json")).unwrap()).unwrap()
}

fn line<'a>(result: &'a Value, source: &str) -> &'a Value {
    let lines = result["budget"]["lines"].as_array().unwrap();
    lines.iter().find(|line| line["source"] == source).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}"))
}

#[test]
fn the_budget_adds_up_and_follows_its_sources() {
    let dir = cell();
    let list = ["--estimate", "a1-3,alpha1-3,bar", "--prior", "datasheet", "--bar-u", "0.001"];
    let result = identify(dir.path(), "one", &list);
    let lines = result["budget"]["lines"].as_array().unwrap();
    let squares: f64 = lines.iter().filter_map(|line| line["position_mm"].as_f64()).map(|mm| mm * mm).sum();
    let combined = number(&result["budget"]["combined_mm"]);
    assert!((squares.sqrt() - combined).abs() < 1e-12 * combined.max(1.0));
    assert_eq!(number(&result["budget"]["expanded_mm"]), 2.0 * combined);
    // u(L) = L alpha u(T) = 300 mm * 12e-6 / K * 0.1 K; it moves the position as an error of the length does.
    let (bar, warm) = (line(&result, "bar"), line(&result, "temperature"));
    assert!((number(&warm["length_mm"]) - 300.0 * 12e-6 * 0.1).abs() < 1e-15);
    assert!((number(&bar["length_mm"]) - 0.001).abs() < 1e-15);
    assert_eq!(bar["basis"], "certificate");
    let leverage = |line: &Value| number(&line["position_mm"]) / number(&line["length_mm"]);
    assert!(leverage(bar) > 0.0 && (leverage(bar) - leverage(warm)).abs() < 1e-9 * leverage(bar));
    // The parts of a length's standard deviation are as large as it.
    let parts = ["noise", "repeatability", "model"]
        .map(|source| line(&result, source)["length_mm"].as_f64().unwrap_or(0.0));
    let whole = parts.iter().map(|mm| mm * mm).sum::<f64>().sqrt();
    assert!((whole - number(&result["noise_mm"]["length"])).abs() < 1e-12);
    assert!((parts[0] - 0.002).abs() < 1e-12);
    // Without a prior, and with an exact bar, the estimate is linear in the noise: twice the noise, twice its contribution.
    let free =
        |out, sigma| identify(dir.path(), out, &["--estimate", "a1-3", "--prior", "none", "--sigma", sigma]);
    let scatter = |found: Value| {
        let parts =
            ["noise", "repeatability", "model"].map(|source| line(&found, source)["position_mm"].as_f64());
        parts.into_iter().flatten().map(|mm| mm * mm).sum::<f64>().sqrt()
    };
    let [one, two] = [free("two", "0.002"), free("three", "0.004")].map(scatter);
    assert!(one > 0.0 && (two / one - 2.0).abs() < 1e-3, "{one} {two}");
}

/// Makes a certificate of a result with an interim check.
const CERTIFICATE: [&str; 6] = ["certificate", "result", "--check", "check.json", "--out", "cert"];

/// A result and its check in `at`, and what making their certificate says.
fn certified(at: &Path) -> (Value, Output) {
    let mut result = identify(at, "result", &["--estimate", "a1-3,bar", "--prior", "none"]);
    // What so few parameters leave has a warning: that is tried below.
    result["findings"] = Value::Array(Vec::new());
    result.as_object_mut().unwrap().remove("sha256");
    fs::write(at.join("result/result.json"), serde_json::to_string_pretty(&result).unwrap()).unwrap();
    let check = "{\"schema\":1,\"robot\":\"KUKA KR 60 HA\",\"lengths\":24,\"decision\":\"pass\",\"rule\":\"guard_band\",\
                 \"tolerance_mm\":0.5,\"position_error_mm\":0.21,\"upper_mm\":0.3,\"guard_band_mm\":0.09,\"specific_risk\":0.01}";
    fs::write(at.join("check.json"), check).unwrap();
    let output = dbbd(at, &CERTIFICATE);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    (result, output)
}

#[test]
fn html_dcc_and_pdf_state_the_result() {
    let dir = cell();
    let at = dir.path();
    let (result, output) = certified(at);
    let pdf = cfg!(feature = "pdf");
    assert_eq!(codes(&output), if pdf { vec![] } else { vec!["I2003".to_owned()] });
    assert_eq!(at.join("cert/certificate.pdf").is_file(), pdf);
    let [html, dcc] =
        ["certificate.html", "dcc.xml"].map(|file| fs::read_to_string(at.join("cert").join(file)).unwrap());
    for text in [&html, &dcc] {
        for stated in [
            "KR-1",
            "Lab &lt;&amp;&gt; 1",
            "A. Example",
            "Plant 7",
            "2026-03-31",
            "B-1",
            "K-77",
            "pass",
            "not accredited",
        ] {
            assert!(text.contains(stated), "{stated}");
        }
    }
    for word in ["http:", "https:", "src=", "url(", "<script", "NaN"] {
        assert!(!html.contains(word), "{word}");
    }
    let combined = format!("<si:value>{}</si:value>", result["budget"]["combined_mm"]);
    assert!(dcc.contains(&combined), "{combined}");
    let is_traceable = |word: &str| dcc.contains(&format!("<dcc:traceable>{word}</dcc:traceable>"));
    assert!(is_traceable("true") || is_traceable("false"), "an xs:boolean");
    // The same result gives the same bytes, and another robot's check is none of it.
    let first = ["certificate.html", "dcc.xml"].map(|file| fs::read(at.join("cert").join(file)).unwrap());
    dbbd(at, &CERTIFICATE);
    assert_eq!(
        ["certificate.html", "dcc.xml"].map(|file| fs::read(at.join("cert").join(file)).unwrap()),
        first
    );
    let check = fs::read_to_string(at.join("check.json")).unwrap();
    let warned = check.replacen(
        '{',
        "{\"findings\":[{\"code\":\"W1918\",\"severity\":\"warning\",\"text\":\"no check\",\"values\":{}}],",
        1,
    );
    fs::write(at.join("check.json"), warned).unwrap();
    let warned = dbbd(at, &CERTIFICATE);
    assert!(
        warned.status.code() == Some(3) && codes(&warned).contains(&"W2005".to_owned()),
        "{}",
        stderr(&warned)
    );
    fs::write(at.join("check.json"), check.replace("KR 60", "KR 6")).unwrap();
    assert_eq!(codes(&dbbd(at, &CERTIFICATE)), ["E2002"]);
    refused_and_warned_of(at);
}

fn refused_and_warned_of(at: &Path) {
    let text = fs::read_to_string(at.join("result/result.json")).unwrap();
    let certificate = |text: &str, more: &[&str]| {
        fs::write(at.join("other.json"), text).unwrap();
        dbbd(at, &[&["certificate", "other.json", "--out", "other"][..], more].concat())
    };
    assert_eq!(codes(&certificate("{}", &[])), ["E2001"]);
    let sealed = serialised::sealed_json(&serde_json::from_str::<Value>(&text).unwrap()).unwrap();
    assert_ne!(codes(&certificate(&sealed, &[])), ["E1808"]);
    assert_eq!(codes(&certificate(&sealed.replacen('1', "2", 1), &[])), ["E1808"]);
    for wrong in ["[bar]\nlength_u_mm = 2.0", "[bar]\ntemperature_c = 68.0", "[bar]\nexpansion_per_k = -1e-5"]
    {
        fs::write(at.join("other.toml"), wrong).unwrap();
        assert_eq!(certificate(&text, &["--identity", "other.toml"]).status.code(), Some(1), "{wrong}");
    }
    fs::write(
        at.join("other.toml"),
        IDENTITY.replace("certified_on = '2026-03-01'", "certified_on = '2026-04-01'"),
    )
    .unwrap();
    assert_eq!(codes(&certificate(&text, &["--identity", "other.toml"])), ["E0680"]);
    fs::write(
        at.join("other.toml"),
        IDENTITY.replace("certified_on = '2026-03-01'", "certified_on = '2015-03-01'"),
    )
    .unwrap();
    assert!(codes(&certificate(&text, &["--identity", "other.toml"])).contains(&"I1846".to_owned()));
    assert_eq!(codes(&certificate(&text.replace("\"budget\"", "\"no_budget\""), &[])), ["E2001"]);
    let none = certificate(&text.replace("\"operator\"", "\"cell\""), &[]);
    assert!(codes(&none).contains(&"I2004".to_owned()) && none.status.code() == Some(0));
    let not_converged = certificate(&text.replace("\"converged\": true", "\"converged\": false"), &[]);
    assert!(codes(&not_converged).contains(&"W2005".to_owned()) && not_converged.status.code() == Some(3));
    fs::write(at.join("other.toml"), "operator = '\u{4e2d}\u{6587}'\n").unwrap();
    let foreign = certificate(&text, &["--identity", "other.toml"]);
    let expected = if cfg!(feature = "pdf") { "E2006" } else { "I2003" };
    assert!(codes(&foreign).contains(&expected.to_owned()));
}

/// pydcc, dccQuantities and, with the feature `pdf`, pikepdf.
#[test]
#[ignore = "needs pydcc, dccQuantities with the network, and pikepdf: .ci/night"]
fn other_programs_read_a_certificate() {
    let dir = cell();
    certified(dir.path());
    client("read_certificate.py", [dir.path().join("cert").as_os_str()].into_iter());
}
