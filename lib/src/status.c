/* One message for each status. */

const char *KOOP(status_message)(int status) {
	switch (status) {
	case KOOP_OK: return "ok";
	case KOOP_E_NULL: return "a pointer that must be given is null";
	case KOOP_E_SIZE: return "a dimension is zero or too large, or sizes do not agree";
	case KOOP_E_STORAGE: return "the storage handed over is too small";
	case KOOP_E_RANGE: return "a setting is outside its range";
	case KOOP_E_INPUT: return "an input is NaN or infinite";
	case KOOP_E_OVERFLOW: return "the result would not be finite in this precision";
	case KOOP_E_INDEFINITE:
		return "the covariance, or the controller's Hessian, would not be positive definite";
	case KOOP_E_MODEL: return "the stored model is damaged or is of another kind";
	default: return "unknown status";
	}
}
