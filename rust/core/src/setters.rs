//! Setters of structs that may get more fields.

/// Methods of the names of some fields that set these: `self.name(value)`. Behind `into`, whatever converts is taken.
macro_rules! setters {
    ($($name:ident: $type:ty),* ; $(into $into:ident: $target:ty),*) => {
        $(
            #[doc = concat!("Sets [`", stringify!($name), "`](Self#structfield.", stringify!($name), ").")]
            #[must_use]
            pub fn $name(mut self, $name: $type) -> Self {
                self.$name = $name;
                self
            }
        )*
        $(
            #[doc = concat!("Sets [`", stringify!($into), "`](Self#structfield.", stringify!($into), ").")]
            #[must_use]
            pub fn $into(mut self, $into: impl Into<$target>) -> Self {
                self.$into = $into.into();
                self
            }
        )*
    };
}
pub(crate) use setters;
