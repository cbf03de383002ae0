//! Values of an attribute: numbers of one type at equal distances in a buffer.

use crate::columns::Column;
use serde::Deserialize;
use slicewalk_base::bytes::ByteSource;
use slicewalk_input::number::Number;
use std::sync::Arc;

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub struct Accessor {
    buffer_view: Option<usize>,
    byte_offset: u64,
    component_type: u64,
    normalized: bool,
    pub count: u64,
    r#type: String,
    sparse: Option<serde::de::IgnoredAny>,
}

impl Accessor {
    fn number(&self) -> Option<Number> {
        Some(match self.component_type {
            5120 => Number::I8,
            5121 => Number::U8,
            5122 => Number::I16,
            5123 => Number::U16,
            5125 => Number::U32,
            5126 => Number::F32,
            _ => return None,
        })
    }

    fn components(&self) -> usize {
        match self.r#type.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 0,
        }
    }

    /// Checks that each value has at least `components` numbers.
    pub fn check(&self, components: usize) -> Result<(), String> {
        if self.sparse.is_some() {
            return Err("sparse values of splats are not read; export the file without them".into());
        }
        if self.number().is_none() {
            return Err(format!("expected a component type of glTF, found {}", self.component_type));
        }
        if self.components() < components {
            return Err(format!("expected {components} numbers a value, found {}", self.components()));
        }
        Ok(())
    }

    /// Returns the number of its buffer view.
    pub fn view(&self) -> Option<usize> {
        self.buffer_view
    }

    /// Returns its values in `view`. `are_shares` if they are from 0 to 1.
    pub fn values(&self, view: Arc<dyn ByteSource>, stride: Option<u64>, are_shares: bool) -> Result<Values, String> {
        let number = self.number().ok_or("expected a component type of glTF")?;
        let components = self.components();
        let width = (components * number.bytes()) as u64;
        let stride = stride.unwrap_or(width);
        if stride < width || stride > 1 << 16 {
            return Err(format!("expected values {width} bytes apart or more, found {stride}"));
        }
        let rest = view.len().saturating_sub(self.byte_offset);
        let needed = self.count.saturating_sub(1).saturating_mul(stride).saturating_add(width);
        if self.count > 0 && needed > rest {
            return Err(format!("it states {} values, and its buffer view ends before them", self.count));
        }
        let divisor = match number {
            // Colours and opacities in whole numbers are shares, even where a draft does not say so.
            Number::U8 if self.normalized || are_shares => 255.0,
            Number::U16 if self.normalized || are_shares => 65_535.0,
            Number::I8 if self.normalized => 127.0,
            Number::I16 if self.normalized => 32_767.0,
            _ => 1.0,
        };
        let start = self.byte_offset;
        Ok(Values { view, start, stride: stride as usize, number, components, divisor, count: self.count })
    }
}

/// Values of an accessor, checked against their buffer.
pub struct Values {
    view: Arc<dyn ByteSource>,
    start: u64,
    stride: usize,
    number: Number,
    components: usize,
    divisor: f64,
    pub count: u64,
}

impl Values {
    /// Returns a reader of all values from the first on.
    pub fn reader(&self) -> ValueReader {
        let width = self.components * self.number.bytes();
        let Self { number, components, divisor, stride, .. } = *self;
        let column = Column::rest(&self.view, self.start);
        ValueReader {
            column,
            row: vec![0; width],
            gap: vec![0; stride - width],
            number,
            components,
            divisor,
            first: true,
        }
    }
}

/// Reader of values in file order.
pub struct ValueReader {
    column: Column,
    row: Vec<u8>,
    /// Bytes between values.
    gap: Vec<u8>,
    number: Number,
    components: usize,
    divisor: f64,
    first: bool,
}

impl ValueReader {
    /// Returns the next value; numbers that it does not have are 1, like an absent alpha.
    pub fn step(&mut self) -> std::io::Result<[f64; 4]> {
        if !std::mem::take(&mut self.first) {
            super::read_row(&mut self.column, &mut self.gap)?;
        }
        super::read_row(&mut self.column, &mut self.row)?;
        let mut value = [1.0; 4];
        for (place, bytes) in value.iter_mut().zip(self.row.chunks_exact(self.number.bytes())).take(self.components) {
            *place = self.number.read(bytes, false) / self.divisor;
            if self.divisor != 1.0 {
                *place = place.max(-1.0);
            }
        }
        Ok(value)
    }
}
