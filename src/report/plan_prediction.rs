//! What a plan will tell, against the number of its lengths and the distance from the balls, as tables.

use serde::Serialize;

use super::plan_view::{PlanView, PredictedRow};
use super::scale::{index, significant};
use crate::identifiability::Observability;
use crate::plan::how_many::Against;

/// A table of numbers, its first column names.
#[derive(Serialize)]
pub(super) struct Table {
    title: &'static str,
    note: &'static str,
    /// Whether the reader opens it.
    folded: bool,
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

/// The tables that a plan has something for.
pub(super) fn tables(view: &PlanView) -> Vec<Table> {
    let mut tables = vec![shells(view), indices(&view.against), deviations(view)];
    tables.retain(|table| !table.rows.is_empty() && table.head.len() > 1);
    tables
}

/// The error by the distance from the base balls.
fn shells(view: &PlanView) -> Table {
    let row = |region: &crate::plan::region::Region| {
        let far = match region.within_mm {
            Some(within) => format!("{} to {within} mm", region.beyond_mm),
            None => format!("beyond {} mm", region.beyond_mm),
        };
        vec![far, significant(region.error_mm, 3)]
    };
    Table {
        title: "By the distance from the nearest base ball",
        note: "",
        folded: false,
        head: vec!["distance".into(), "3-D error left, rms (mm)".into()],
        rows: view.regions.iter().map(row).collect(),
    }
}

/// Error, rank and observability indices against the number of lengths.
fn indices(against: &[Against]) -> Table {
    let line = |name: &str, value: &dyn Fn(&Against) -> String| {
        std::iter::once(name.to_owned()).chain(against.iter().map(value)).collect()
    };
    let observed = |name: &str, of: fn(&Observability) -> f64| {
        line(name, &|part| part.observability.as_ref().map_or("–".into(), |o| index(of(o))))
    };
    Table {
        title: "Against the number of lengths",
        note: "The most telling lengths of the plan first; the last column is the plan measured twice. O1 to O5: the \
               observability indices of Sun and Hollerbach of what is told, its columns in units of what is known \
               beforehand; larger is better, and they fall where a higher rank brings in what is told less well.",
        folded: false,
        head: head(against),
        rows: vec![
            line("3-D error (mm)", &|part| significant(part.error_mm, 3)),
            line("rank", &|part| part.rank.to_string()),
            observed("O1", |o| o.o1),
            observed("O2", |o| o.o2),
            observed("O3", |o| o.o3),
            observed("O4", |o| o.o4),
            observed("O5", |o| o.o5),
        ],
    }
}

/// The standard deviation of each parameter against the number of lengths.
fn deviations(view: &PlanView) -> Table {
    let row = |parameter: &PredictedRow| {
        let (unit, factor) = if parameter.unit == "mm" { ("µm", 1e3) } else { ("µrad", 1e6) };
        let value = |part: &Against| {
            part.sd.get(&parameter.name).map_or("–".into(), |sd| significant(sd * factor, 3))
        };
        std::iter::once(format!("{} ({unit})", parameter.name))
            .chain(view.against.iter().map(value))
            .collect()
    };
    Table {
        title: "Standard deviation of each parameter against the number of lengths",
        note: "",
        folded: true,
        head: head(&view.against),
        rows: view.predicted.iter().map(row).collect(),
    }
}

fn head(against: &[Against]) -> Vec<String> {
    std::iter::once("lengths".to_owned()).chain(against.iter().map(|part| part.lengths.to_string())).collect()
}
