/* What regulators need that have memory, that adjust a step, or that reshape P. Other regulators do not link it.
 *
 * A refused sample leaves memory and P as they were, bit for bit. For that the storage ends with a copy of the
 * memory and, if P is reshaped, of the stored P, the gain and the numbers of P. */

#define EXTENSION_NUMBERS 4

static COLD size_t extension_reals(KOOP(rls) *rls) {
	const KOOP(extension) *own = rls->config.regulator->extension;
	rls->n_memory = own->reals ? own->reals(rls) : 0;
	const size_t memory = rls->n_undo = KOOP_PAD(rls->n_memory);
	if (!own->reshape) { return 2 * memory; }
	rls->n_undo += rls->config.form->reals(rls);
	return memory + rls->n_undo + rls->n_regressors_padded + EXTENSION_NUMBERS;
}

static COLD void extension_reset(KOOP(rls) *rls) {
	for (size_t i = 0; i < rls->n_memory; i++) { rls->memory[i] = 0; }
	if (rls->config.regulator->extension->reset) { rls->config.regulator->extension->reset(rls); }
}

static COLD void extension_keep(KOOP(rls) *rls) {
	real *numbers = rls->undo + rls->n_undo + rls->n_regressors_padded;
	copy(rls->undo, rls->memory, rls->n_undo);
	if (!rls->config.regulator->extension->reshape) { return; }
	numbers[0] = rls->covariance_scale;
	numbers[1] = rls->covariance_bound;
	numbers[2] = (real)rls->positive_definite;
	numbers[3] = (real)rls->mirrored;
}

static COLD void extension_undo(KOOP(rls) *rls) {
	const real *numbers = rls->undo + rls->n_undo + rls->n_regressors_padded;
	copy(rls->memory, rls->undo, rls->n_undo);
	if (!rls->config.regulator->extension->reshape) { return; }
	rls->covariance_scale = numbers[0];
	rls->covariance_bound = numbers[1];
	rls->positive_definite = numbers[2] > 0;
	rls->mirrored = (size_t)numbers[3];
}

static COLD int extension_adjust(KOOP(rls) *rls, real s, KOOP(step) *step, int *frozen) {
	const KOOP(extension) *own = rls->config.regulator->extension;
	const int status = own->adjust ? own->adjust(rls, s, step) : KOOP_OK;
	*frozen = !step->update_covariance;
	return status;
}

/* Theta's change, which comes later, still needs the gain. */
static COLD int extension_reshape(KOOP(rls) *rls) {
	real *gain = rls->undo + rls->n_undo;
	if (!rls->config.regulator->extension->reshape) { return KOOP_OK; }
	copy(gain, rls->gain, rls->n_regressors_padded);
	const int status = rls->config.regulator->extension->reshape(rls);
	copy(rls->gain, gain, rls->n_regressors_padded);
	return status;
}

static COLD int extension_learn(KOOP(rls) *rls, real innovation, int *frozen) {
	extension_keep(rls);
	const int status = change_model(rls, innovation, frozen);
	if (status != KOOP_OK) { extension_undo(rls); }
	seal(rls); /* the memory can change where the model does not */
	return status;
}

const KOOP(engine) KOOP(reg_engine) = {extension_reals, extension_reset, extension_learn, extension_adjust,
                                       extension_reshape};

/* ---- Further changes of P --------------------------------------------------------- */

/* Changes P by K in rls->gain, as one step does. */
static COLD int change_covariance(KOOP(rls) *rls, real noise, real scale, real denominator, real inverse) {
	const KOOP(step) step = {noise, scale, 0, 0, 0, 0, 0, 1};
	if (!(MATH(fabs)(denominator) < REAL_MAX / 4)) { return KOOP_E_OVERFLOW; }
	rls->gain_square = scaled_dot(rls->gain, inverse, rls->gain, rls->n_regressors_padded);
	return is_finite(rls->gain_square) ? rls->config.form->apply(rls, &step, denominator) : KOOP_E_OVERFLOW;
}

static COLD int change_check(const KOOP(rls) *rls, const real *v, real a) {
	if (!rls || !rls->theta || !v) { return KOOP_E_NULL; }
	if (!(a > 0 && 1 / a < REAL_MAX / 4)) { return KOOP_E_RANGE; }
	return all_finite(v, rls->n_regressors) ? KOOP_OK : KOOP_E_INPUT;
}

COLD int KOOP(rls_add_information)(KOOP(rls) *rls, const real *v, real a) {
	const int status = change_check(rls, v, a);
	if (status != KOOP_OK) { return status; }
	copy(rls->zeta, v, rls->n_regressors);
	const real denominator = 1 / a + rls->config.form->gain(rls);
	return change_covariance(rls, 1 / a, 1, denominator, 1 / denominator);
}

COLD int KOOP(rls_add_covariance)(KOOP(rls) *rls, const real *v, real a) {
	const int status = change_check(rls, v, a);
	if (status != KOOP_OK) { return status; }
	for (size_t i = 0; i < rls->n_regressors_padded; i++) { rls->gain[i] = 0; }
	copy(rls->gain, v, rls->n_regressors);
	return change_covariance(rls, -a, 1, -a, 1);
}

COLD int KOOP(rls_scale_covariance)(KOOP(rls) *rls, real factor) {
	if (!rls || !rls->theta) { return KOOP_E_NULL; }
	if (!(factor > 0 && factor < REAL_MAX / 4)) { return KOOP_E_RANGE; }
	for (size_t i = 0; i < rls->n_regressors_padded; i++) { rls->zeta[i] = 0; }
	(void)rls->config.form->gain(rls); /* 0, and so is what the form has worked out for apply() */
	return change_covariance(rls, 1, factor, 1, 1);
}
