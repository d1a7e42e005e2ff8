//! Functions compiled for several instruction sets, the best of which is chosen at run time.
//!
//! Loops are written plainly and left to the compiler to vectorise. Arithmetic is the same in each
//! version (fused multiply-adds are written out), so results do not depend on the machine.

/// Instruction sets that kernels are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Level {
    /// The instructions that the target has in any case.
    Base,
    /// AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 as in x86-64-v4.
    #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
    Avx512,
}

impl Level {
    /// The best that this machine has (the standard library keeps the answer).
    #[inline]
    pub(crate) fn best() -> Level {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            let v3 = has!("avx2") && has!("fma");
            #[cfg(feature = "avx512")]
            if v3 && has!("avx512f") && has!("avx512dq") && has!("avx512vl") && has!("avx512bw") {
                return Level::Avx512;
            }
            if v3 {
                return Level::Avx2;
            }
        }
        Level::Base
    }
}

/// `kernel! { fn name(arg: Type, ...) -> Type { ... } }` defines a function that runs in the version
/// for the best instruction set; what it calls must be inlined to profit.
macro_rules! kernel {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        $vis fn $name($($arg: $type),*) $(-> $ret)? {
            #[inline(always)]
            fn body($($arg: $type),*) $(-> $ret)? $body
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2($($arg: $type),*) $(-> $ret)? {
                body($($arg),*)
            }
            #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
            #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,avx2,fma")]
            fn avx512($($arg: $type),*) $(-> $ret)? {
                body($($arg),*)
            }
            match $crate::simd::Level::best() {
                // SAFETY: the machine has these instructions.
                #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
                $crate::simd::Level::Avx512 => unsafe { avx512($($arg),*) },
                #[cfg(target_arch = "x86_64")]
                $crate::simd::Level::Avx2 => unsafe { avx2($($arg),*) },
                $crate::simd::Level::Base => body($($arg),*),
            }
        }
    };
}

pub(crate) use kernel;
