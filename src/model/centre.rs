//! Where the base balls stand: their CSV.

use nalgebra::Vector3;

use crate::diag::Diagnostic;
use crate::table::{self, Columns};

/// A base ball: its number (from 1) and its centre in the robot base, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Centre {
    /// Number, from 1.
    pub id: usize,
    /// Centre in the robot base, mm.
    pub position: Vector3<f64>,
}

impl Centre {
    /// Reads the CSV `centre,x_mm,y_mm,z_mm`: the balls in order of their numbers, which run from 1.
    ///
    /// # Errors
    /// Names the line of what is missing, not a number, or a number that is twice there or absent.
    pub fn from_csv(file: &str, text: &str) -> Result<Vec<Self>, Diagnostic> {
        let mut reader = table::reader().from_reader(text.as_bytes());
        let header = reader.headers().map_err(|error| Diagnostic::csv(file, &error))?.clone();
        let columns = Columns { file, header: &header };
        let [number, x, y, z] = columns.required(["centre", "x_mm", "y_mm", "z_mm"])?;
        let mut centres = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|error| Diagnostic::csv(file, &error))?;
            let row = columns.row(&record);
            let position = Vector3::new(row.number(x)?, row.number(y)?, row.number(z)?);
            centres.push(Self { id: row.whole(number, 1)? as usize, position });
        }
        centres.sort_by_key(|centre| centre.id);
        for (at, centre) in centres.iter().enumerate() {
            if centre.id != at + 1 {
                let message =
                    format!("the numbers in column `centre` must run 1, 2, ..: {} is next", centre.id);
                return Err(Diagnostic::file(file, message));
            }
        }
        Ok(centres)
    }

    /// Writes the CSV.
    pub fn to_csv(centres: &[Self]) -> String {
        let mut text = String::from("centre,x_mm,y_mm,z_mm\n");
        for Self { id, position } in centres {
            text.push_str(&format!("{id},{},{},{}\n", position.x, position.y, position.z));
        }
        text
    }
}
